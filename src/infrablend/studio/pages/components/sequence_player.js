// Plays the frames of a sequence in order, with the boxes of its tracks, above a timeline with a bar per track.
// Pictures are decoded ahead and painted together with their boxes, so that a box is never on another frame.
const AHEAD = 16, BEHIND = 2, AT_ONCE = 4, LATE_S = 0.1, QUIET_MS = 250, LEAP = 10;

export default {
  template: `
    <p v-if="problem" class="studio-error" role="alert">{{ problem }}</p>
    <section v-if="sequence" class="player" aria-label="Player">
      <div class="player-stage" @click="toggle">
        <canvas ref="canvas" class="picture" role="img" :aria-label="'Frame ' + id"></canvas>
        <svg :viewBox="'0 0 ' + size.join(' ')" aria-hidden="true">
          <g v-for="m in marks" :class="{ original: !m.track.inserted }">
            <rect :x="m.box[0]" :y="m.box[1]" :width="m.box[2] - m.box[0]" :height="m.box[3] - m.box[1]"></rect>
            <text :x="m.box[0]" :y="textAt(m.box)" :font-size="size[0] / 45">{{ m.track.id }}</text>
          </g>
        </svg>
      </div>
      <div class="studio-row">
        <button type="button" @mousedown.prevent @click="toggle">{{ playing ? "Pause" : "Play" }} <kbd>Space</kbd></button>
        <button type="button" @mousedown.prevent @click="step(-1)">Previous <kbd>\u2190</kbd></button>
        <button type="button" @mousedown.prevent @click="step(1)">Next <kbd>\u2192</kbd></button>
        <label>Speed <select v-model.number="speed" @change="$event.target.blur()">
          <option v-for="s in [0.25, 0.5, 1, 2]" :value="s">{{ s }} x</option>
        </select></label>
        <label v-for="(name, key) in { b: 'Boxes', o: 'Original objects' }" @mousedown.prevent>
          <input type="checkbox" v-model="shown[key]"> {{ name }} <kbd>{{ key.toUpperCase() }}</kbd></label>
        <a :href="'/review' + query" @click="keep">Review this frame</a>
        <span class="player-time">{{ at + 1 }} of {{ count }}, {{ sequence.times[at].toFixed(2) }} s</span>
      </div>
      <div class="timeline-scroll">
        <div class="timeline">
          <span class="faint">Frame</span>
          <div class="timeline-ruler">
            <input type="range" min="0" :max="count - 1" :value="at" aria-label="Frame" :aria-valuetext="id"
                   @input="seek(+$event.target.value)">
          </div>
          <template v-for="t in sequence.tracks">
            <button type="button" :title="t.title" :aria-label="t.title" @mousedown.prevent @click="seek(t.at[0])">
              {{ t.category }} {{ t.id }}<span v-if="!t.inserted" class="faint"> original</span></button>
            <svg class="timeline-bar" :class="{ original: !t.inserted }" :viewBox="'0 0 ' + count + ' 1'" aria-hidden="true"
                 preserveAspectRatio="none" @pointerdown.prevent="grab" @pointermove="drag">
              <rect v-for="[from, to] in t.spans" :x="from" :width="to + 1 - from" height="1"></rect>
            </svg>
          </template>
          <div class="timeline-now" aria-hidden="true">
            <span :style="{ left: (100 * (at + 0.5)) / count + '%' }"></span>
          </div>
        </div>
      </div>
    </section>
    <p v-else-if="!problem" class="faint">Reading the sequence...</p>`,
  props: { source: String, start: Number },
  data() {
    return {
      sequence: null, problem: "", at: 0, playing: false, speed: 1, size: [640, 512], shown: { b: true, o: true },
    };
  },
  computed: {
    count() {
      return this.sequence.frames.length;
    },
    id() {
      return this.sequence.frames[this.at][1];
    },
    query() {
      return "?frame=" + encodeURIComponent(this.id).replaceAll("%2F", "/"); // as elsewhere in the studio
    },
    marks() {
      if (!this.shown.b) return [];
      return this.sequence.marks[this.at].filter((m) => m.track.inserted || this.shown.o);
    },
  },
  async mounted() {
    this.pictures = new Map(); // ImageBitmap, or its `problem`, by position; null while it is on its way
    this.clock = 0; // second of the sequence while it plays
    addEventListener("keydown", this.keyed);
    try {
      const answer = await fetch(this.source);
      if (!answer.ok) throw new Error(await answer.text());
      const sequence = await answer.json();
      sequence.marks = sequence.frames.map(() => []);
      for (const track of sequence.tracks) {
        track.spans = [];
        track.at.forEach((at, k) => {
          sequence.marks[at].push({ track, box: track.boxes[k] });
          const last = track.spans.at(-1);
          if (last && at <= last[1] + 1) last[1] = at;
          else track.spans.push([at, at]);
        });
        const seen = track.spans.map(([from, to]) => `${from + 1} to ${to + 1}`).join(", ");
        track.title = `${track.category} ${track.id}, ${track.inserted ? "inserted" : "original"}: frames ${seen}`;
      }
      this.sequence = Object.freeze(sequence);
      this.seek(this.start);
    } catch (error) {
      this.problem = `The sequence cannot be read: ${error.message}`;
    }
  },
  unmounted() {
    removeEventListener("keydown", this.keyed);
    this.playing = false;
    clearTimeout(this.timer);
    this.pictures.forEach((picture) => picture?.close?.());
  },
  methods: {
    textAt(box) {
      // Below boxes that leave no place above.
      const [high, gap] = [this.size[0] / 45, this.size[0] / 160];
      return box[1] > high + gap ? box[1] - gap : box[3] + high;
    },
    seek(at) {
      this.wanted = Math.max(0, Math.min(this.count - 1, at));
      this.clock = this.sequence.times[this.wanted];
      this.paint();
    },
    step(by) {
      this.playing = false;
      this.seek(this.wanted + by);
    },
    toggle() {
      this.playing = !this.playing;
      if (!this.playing) return;
      if (this.wanted === this.count - 1) this.seek(0);
      this.last = performance.now();
      this.waits = true;
      requestAnimationFrame(this.tick);
    },
    tick(now) {
      if (!this.playing) return;
      const times = this.sequence.times, next = this.wanted + 1;
      this.clock += ((now - this.last) / 1000) * this.speed;
      this.last = now;
      // Every frame is seen: the clock waits for its picture, and for one tick after it has come.
      if (this.waits) this.clock = times[this.wanted];
      else if (next === this.count) this.playing = false;
      else if (this.clock >= times[next]) {
        this.wanted = next;
        this.clock = Math.min(this.clock, times[next] + LATE_S);
        this.paint();
      }
      this.waits = this.at !== this.wanted;
      requestAnimationFrame(this.tick);
    },
    paint() {
      // Show the wanted frame if its picture is there, and fetch what comes next.
      const picture = this.pictures.get(this.wanted), canvas = this.$refs.canvas;
      if (picture && canvas) {
        this.problem = picture.problem || "";
        if (this.problem) {
          this.playing = false;
          canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height);
        } else this.draw(picture, canvas);
        this.at = this.wanted;
        clearTimeout(this.timer);
        this.timer = setTimeout(this.keep, QUIET_MS);
      }
      for (const [at, old] of this.pictures) {
        if (old && (at < this.wanted - BEHIND || at > this.wanted + AHEAD)) {
          old.close?.();
          this.pictures.delete(at);
        }
      }
      const underway = [...this.pictures.values()].filter((p) => !p).length;
      const due = Array.from({ length: AHEAD }, (_, k) => this.wanted + k);
      const missing = due.filter((at) => at < this.count && !this.pictures.has(at));
      missing.slice(0, AT_ONCE - underway).forEach((at) => this.load(at));
    },
    keep() {
      clearTimeout(this.timer);
      history.replaceState(history.state, "", this.query);
    },
    draw(picture, canvas) {
      if (canvas.width !== picture.width || canvas.height !== picture.height) {
        this.size = [(canvas.width = picture.width), (canvas.height = picture.height)];
      }
      canvas.getContext("2d").drawImage(picture, 0, 0);
    },
    async load(at) {
      this.pictures.set(at, null);
      const [n, , digest] = this.sequence.frames[at];
      try {
        const answer = await fetch(`/run/picture/${n}.png?d=${digest}`);
        if (!answer.ok) throw new Error(await answer.text());
        this.pictures.set(at, await createImageBitmap(await answer.blob()));
      } catch (error) {
        this.pictures.set(at, { problem: error.message });
      }
      this.paint();
    },
    grab(event) {
      event.currentTarget.setPointerCapture(event.pointerId);
      this.drag(event);
    },
    drag(event) {
      if (!event.currentTarget.hasPointerCapture(event.pointerId)) return;
      const box = event.currentTarget.getBoundingClientRect();
      this.seek(Math.floor(((event.clientX - box.left) / box.width) * this.count));
    },
    keyed(event) {
      const target = event.target, key = event.key.toLowerCase();
      if (!this.sequence || event.ctrlKey || event.metaKey || event.altKey) return;
      if (target.matches("input:not([type=range], [type=checkbox]), select, textarea")) return;
      if (key === " " && target.matches("button, a, [type=checkbox]")) return; // it presses them
      const by = event.shiftKey ? LEAP : 1;
      const actions = {
        " ": () => this.toggle(), arrowright: () => this.step(by), arrowleft: () => this.step(-by),
        home: () => this.step(-Infinity), end: () => this.step(Infinity),
        b: () => (this.shown.b = !this.shown.b), o: () => (this.shown.o = !this.shown.o),
      };
      if (!(key in actions)) return;
      event.preventDefault();
      if (!event.repeat || key.startsWith("arrow")) actions[key]();
    },
  },
};
