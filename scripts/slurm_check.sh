#!/usr/bin/env bash
# Runs the SLURM template of docs/how_to/cluster.md, as it stands there, on a cluster of one controller and two nodes, all on
# this machine.
#
#     scripts/slurm_check.sh [DATA]      a dataset; without one, a virtual world of 8 pictures is made, which needs Blender
#
# Installs nothing: it needs Debian's packages `slurm-wlm` and `munge`. Everything is in a folder in /tmp, which remains if
# something fails. 8 shards are rendered. One node is killed while it renders, and its shard is queued again; another shard
# is told that its time is over, and continues. The merged run has to have the bytes of an undivided one. Takes minutes, so
# `make test` does not run it.
set -euo pipefail
cd "$(dirname "$0")/.."
export PATH="$PATH:/usr/sbin:/sbin"

for program in munged slurmctld slurmd sbatch; do
  command -v "$program" > /dev/null || { echo "no $program: apt-get install slurm-wlm munge" >&2; exit 3; }
done

infrablend="$PWD/.venv/bin/infrablend"
python="$PWD/.venv/bin/python"
page="$PWD/docs/how_to/cluster.md"
folder=$(mktemp -d /tmp/slurm-check-XXXXXX)
cluster="check$$"
shards=8

step() { printf '\n== %s\n' "$*"; }

# Prints the ids of processes of a node's jobs, and of this script's cluster only.
jobs_of() {
  local file
  for file in $(grep -slzx "SLURMD_NODENAME=$1" /proc/[0-9]*/environ || true); do
    if grep -sqzx "SLURM_CLUSTER_NAME=$cluster" "$file"; then basename "$(dirname "$file")"; fi
  done
}

stop_cluster() {
  local file process
  for process in $(jobs_of n1) $(jobs_of n2); do kill -KILL "$process" 2> /dev/null || true; done
  for file in "$folder"/slurmd-n1.pid "$folder"/slurmd-n2.pid "$folder"/slurmctld.pid "$folder"/munge/pid; do
    if [ -s "$file" ]; then kill "$(cat "$file")" 2> /dev/null || true; fi
  done
}
trap stop_cluster EXIT

start_cluster() {
  local host user
  host=$(hostname -s)
  user=$(id -un)
  mkdir "$folder/state" "$folder/munge"
  (umask 077 && head -c 1024 /dev/urandom > "$folder/munge/key")
  chmod 755 "$folder" "$folder/munge"
  munged --key-file="$folder/munge/key" --socket="$folder/munge/socket" --pid-file="$folder/munge/pid" \
    --log-file="$folder/munge/log" --seed-file="$folder/munge/seed"
  # No cgroups: processes are followed by their parents, so that it also runs in a container.
  cat > "$folder/slurm.conf" << CONF
ClusterName=$cluster
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=16817
SlurmUser=$user
SlurmdUser=$user
AuthType=auth/munge
AuthInfo=socket=$folder/munge/socket
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool-%n
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd-%n.pid
SlurmctldLogFile=$folder/slurmctld.log
SlurmdLogFile=$folder/slurmd-%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=batch_sched_delay=1,sched_interval=2
SlurmdTimeout=10
ReturnToService=2
MinJobAge=3600
NodeName=n1,n2 NodeHostname=$host NodeAddr=127.0.0.1 Port=16821,16822 CPUs=1 RealMemory=8192
PartitionName=all Nodes=n1,n2 Default=YES MaxTime=INFINITE
CONF
  export SLURM_CONF="$folder/slurm.conf"
  slurmctld -i
  slurmd -N n1
  slurmd -N n2
  for _ in $(seq 60); do
    if [ "$(sinfo -h -t idle -o %D 2> /dev/null || true)" = 2 ]; then return; fi
    sleep 1
  done
  echo "the nodes did not come up; see $folder/*.log" >&2
  exit 1
}

# Waits until a task of the array that matches squeue's options has rendered a frame, and prints its number.
rendering() {
  local task number
  for _ in $(seq 1200); do
    for task in $(squeue -h -r -j "$array" -t R "$@" -o %K 2> /dev/null); do
      number=$(printf '%05d' "$task")
      if compgen -G "$folder/shards/.shard-$number-of-*.partial/images/*/*" > /dev/null; then
        echo "$task"
        return
      fi
    done
    sleep 0.2
  done
  echo "no shard renders; see $folder" >&2
  exit 1
}

step "a cluster of two nodes ($(slurmctld -V))"
start_cluster
sinfo -N

data=${1:-$folder/world}
if [ $# -eq 0 ]; then
  step "backgrounds"
  "$infrablend" --quiet world --out "$data" --count 8 --seed 0
fi
words=(hit-uav-drone-physical --data "$data" --limit 8 --set configurations=4 --set output.image=png)

step "one undivided run"
"$infrablend" --quiet generate "${words[@]}" --out "$folder/whole" --workers 2 > "$folder/said"
head -n 3 "$folder/said"

step "$shards shards, and a job that merges them"
cd "$folder"
sed -n '/^#!\/bin\/bash$/,/^```$/p' "$page" | sed '$d' > shards.sh
export PATH="$(dirname "$infrablend"):$PATH"
array=$(sbatch --parsable --array="1-$shards" --cpus-per-task=1 --mem=2G --time=30 shards.sh "${words[@]}" --out "$folder/shards")
merge=$(sbatch --parsable --dependency="afterany:$array" --mem=4G --wrap "infrablend --quiet merge --resume shards merged")
echo "shards: job $array, merge: job $merge"

step "node n2 dies"
killed=$(rendering -w n2)
victims=$(jobs_of n2)
parents=$(for process in $victims; do ps -o ppid= -p "$process" || true; done | sort -un)
steps=$(for process in $parents; do ps -o pid=,comm= -p "$process" || true; done | awk '$2 == "slurmstepd" { print $1 }')
for process in $(cat slurmd-n2.pid) $steps $victims; do kill -KILL "$process" 2> /dev/null || true; done
echo "shard $killed of $shards was killed with everything on n2, after $(find "$folder/shards/".shard-"$(printf '%05d' "$killed")"-of-*.partial/images -type f | wc -l) frames"
slurmd -N n2

step "the time of another shard is over"
stopped=$(rendering -w n1)
# scancel would send the signal again once the task has been queued again, minutes later.
timeout 2 scancel --batch --signal=USR1 "$(squeue -h -r -j "${array}_$stopped" -o %A)" || true
echo "shard $stopped of $shards got SIGUSR1"

step "the end"
for _ in $(seq 900); do
  if [ -z "$(squeue -h -j "$array,$merge" 2> /dev/null || true)" ]; then break; fi
  sleep 1
done
for job in "$array" "$merge"; do
  scontrol -o show job "$job"
done | sed -E 's/.*ArrayTaskId=([0-9]+) .*JobState=([A-Z_]+) .*Restarts=([0-9]+) .* NodeList=(n[12]).*/task \1: \2, \3 restarts, at last on \4/; s/.*JobName=wrap .*JobState=([A-Z_]+) .*/merge: \1/' | sort -V
"$infrablend" status "$folder/shards"

step "the merged run against the undivided one"
"$python" - "$folder/whole" "$folder/merged" << 'PYTHON'
import hashlib, json, sqlite3, sys
from pathlib import Path

def digests(run):
    found = {}
    for path in sorted(p for p in run.rglob("*") if p.is_file()):
        name = path.relative_to(run).as_posix()
        if name in ("workers.log", "report.html"):  # times
            continue
        data = path.read_bytes()
        if name == "run.json":
            record = json.loads(data)
            data = json.dumps({k: v for k, v in record.items() if k not in ("timing", "machine", "out")}, sort_keys=True).encode()
        if name == "run.sqlite":
            rows = [sqlite3.connect(path).execute(f"SELECT * FROM {t} ORDER BY frame_id").fetchall() for t in ("frames", "records")]
            data = repr(rows).encode()
        found[name] = hashlib.sha256(data).hexdigest()
    return found

whole, merged = (digests(Path(p)) for p in sys.argv[1:])
other = sorted(n for n in whole.keys() | merged.keys() if whole.get(n) != merged.get(n))
print(f"{len(whole)} files in the undivided run, {len(merged)} in the merged one, {len(other)} differ", *other[:10], sep="\n  ")
sys.exit(bool(other) or not whole)
PYTHON
restarts=$(scontrol -o show job "$array" | grep -c 'Restarts=[1-9]' || true)
if [ "$restarts" -lt 2 ]; then
  echo "only $restarts shards were queued again, expected both" >&2
  exit 1
fi
stop_cluster
trap - EXIT
rm -rf "$folder"
printf '\nslurm_check: passed\n'
