// The picture of a frame with a handle on each insert: drag it, or focus it and use the keys. With a pen, lines are
// painted; with a path, its points are added, moved and deleted.
const STEP_PX = 1, FAR_STEP_PX = 10, TURN_DEG = 5, AWAY = 1.05, QUIET_MS = 120;

export default {
  template: `
    <div class="stage" ref="box">
      <img class="picture" :src="source || undefined" :alt="alt" draggable="false" @load="loaded">
      <button v-for="(m, k) in marks" :key="k" type="button" class="stage-handle" :style="place(m, k)" :title="help"
              :aria-label="m.name + ', insert ' + (k + 1) + '. ' + help" @pointerdown.prevent="grab($event, k)"
              @pointermove="drag" @pointerup="drop" @pointercancel="drop" @keydown="keyed($event, k)"></button>
      <svg v-if="pen" class="stage-paint" :viewBox="'0 0 ' + size.join(' ')" @pointerdown.prevent="begin"
           @pointermove="extend" @pointerup="finish" @pointercancel="finish">
        <polyline :points="line.join(' ')" :stroke-width="pen"></polyline>
      </svg>
      <svg v-else-if="path" class="stage-paint" :viewBox="'0 0 ' + size.join(' ')" @pointerdown.prevent="add">
        <polyline :points="route().join(' ')" stroke-width="2"></polyline>
      </svg>
      <template v-if="path && !pen">
        <button v-for="(p, k) in route()" :key="'p' + k" type="button" class="stage-point" :style="at(p)"
                :aria-label="'Point ' + (k + 1) + ' of the path. Drag, or arrow keys to move, Delete to remove'"
                @pointerdown.prevent="pull($event, k)" @pointermove="tug" @pointerup="leave" @pointercancel="leave"
                @keydown="nudge($event, k)">{{ k + 1 }}</button>
      </template>
    </div>`,
  props: { source: String, alt: String, marks: Array, size: Array, pen: Number, path: Array },
  data() {
    return {
      held: null, shift: [0, 0], line: [], paints: false, pulled: null,
      help: "Drag, or arrow keys to move, [ and ] to turn, + and - for nearer and farther, Delete to let it go",
    };
  },
  methods: {
    loaded() {
      if (!this.paints) this.line = []; // until then, it shows what is painted
    },
    begin(event) {
      event.currentTarget.setPointerCapture(event.pointerId);
      this.line = [];
      this.paints = true;
      this.extend(event);
      this.extend(event);
    },
    extend(event) {
      if (!this.paints) return;
      const box = event.currentTarget.getBoundingClientRect(), scale = this.size[0] / box.width;
      this.line.push([(event.clientX - box.left) * scale, (event.clientY - box.top) * scale]);
    },
    finish() {
      if (!this.paints) return;
      this.paints = false;
      this.$emit("paint", { line: this.line });
    },
    scale() {
      return this.size[0] / this.$refs.box.clientWidth;
    },
    route() {
      return this.path.map((p, k) => (this.pulled && this.pulled.k === k ? this.pulled.at : p));
    },
    at(p) {
      return { left: (100 * p[0]) / this.size[0] + "%", top: (100 * p[1]) / this.size[1] + "%" };
    },
    add(event) {
      const box = event.currentTarget.getBoundingClientRect();
      this.$emit("add", { x: (event.clientX - box.left) * this.scale(), y: (event.clientY - box.top) * this.scale() });
    },
    pull(event, k) {
      event.currentTarget.setPointerCapture(event.pointerId);
      event.currentTarget.focus();
      this.pulled = { k, x: event.clientX, y: event.clientY, from: [...this.path[k]], at: [...this.path[k]] };
    },
    tug(event) {
      if (!this.pulled) return;
      const { x, y, from } = this.pulled, scale = this.scale();
      this.pulled.at = [from[0] + (event.clientX - x) * scale, from[1] + (event.clientY - y) * scale];
    },
    leave() {
      if (!this.pulled) return;
      const { k, at, from } = this.pulled;
      if (Math.hypot(at[0] - from[0], at[1] - from[1]) >= 1) {
        this.path[k] = at; // until the answer comes
        this.$emit("point", { k, x: at[0], y: at[1] });
      }
      this.pulled = null;
    },
    nudge(event, k) {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const step = event.shiftKey ? FAR_STEP_PX : STEP_PX;
      const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
      const move = moves[event.key];
      if (!move && event.key !== "Delete") return;
      event.preventDefault();
      if (!move) return this.$emit("point", { k, remove: true });
      const at = [this.path[k][0] + move[0], this.path[k][1] + move[1]];
      this.path[k] = at;
      this.$emit("point", { k, x: at[0], y: at[1] });
    },
    place(m, k) {
      const [w, h] = this.size, [dx, dy] = this.held && this.held.k === k ? this.shift : [0, 0];
      const pad = 3, x0 = m.box[0] - pad + dx, y0 = m.box[1] - pad + dy;
      return {
        left: (100 * x0) / w + "%", top: (100 * y0) / h + "%",
        width: (100 * (m.box[2] - m.box[0] + 2 * pad)) / w + "%", height: (100 * (m.box[3] - m.box[1] + 2 * pad)) / h + "%",
      };
    },
    grab(event, k) {
      event.currentTarget.setPointerCapture(event.pointerId);
      event.currentTarget.focus();
      this.held = { k, x: event.clientX, y: event.clientY, at: [...this.marks[k].origin] };
      this.shift = [0, 0];
    },
    drag(event) {
      if (!this.held) return;
      const scale = this.size[0] / this.$refs.box.clientWidth;
      this.shift = [(event.clientX - this.held.x) * scale, (event.clientY - this.held.y) * scale];
    },
    drop() {
      if (!this.held) return;
      const { k, at } = this.held, [dx, dy] = this.shift;
      this.held = null;
      if (Math.hypot(dx, dy) < 1) return;
      this.$emit("place", { k, x: at[0] + dx, y: at[1] + dy });
    },
    keyed(event, k) {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const step = event.shiftKey ? FAR_STEP_PX : STEP_PX;
      const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
      const others = {
        "[": { turn: -TURN_DEG }, "]": { turn: TURN_DEG }, "+": { away: 1 / AWAY }, "=": { away: 1 / AWAY },
        "-": { away: AWAY }, Delete: { release: true },
      };
      if (!(event.key in moves) && !(event.key in others)) return;
      event.preventDefault();
      // Held keys add up until there is a pause: one small event for many steps.
      const sum = this.sum && this.sum.k === k ? this.sum : { k, dx: 0, dy: 0, turn: 0, away: 1, release: false };
      const [dx, dy] = moves[event.key] || [0, 0], other = others[event.key] || {};
      this.sum = {
        k, dx: sum.dx + dx, dy: sum.dy + dy, turn: sum.turn + (other.turn || 0), away: sum.away * (other.away || 1),
        release: sum.release || !!other.release,
      };
      clearTimeout(this.timer);
      this.timer = setTimeout(() => {
        this.$emit("adjust", this.sum);
        this.sum = null;
      }, QUIET_MS);
    },
  },
};
