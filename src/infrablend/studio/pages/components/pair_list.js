// A list of frames that keeps only the visible lines in the page.
const LINE = 52, OVERSCAN = 6;

export default {
  template: `
    <div ref="box" class="pair-list" role="group" aria-label="Frames" @scroll.passive="scrolled" @keydown="keyed">
      <p v-if="problem" class="frame-grid-note" role="alert">{{ problem }}</p>
      <p v-else-if="!rows" class="frame-grid-note">Reading the frames...</p>
      <p v-else-if="!rows.length" class="frame-grid-note">No such frame.</p>
      <div v-if="rows" :style="{ height: rows.length * line + 'px', position: 'relative' }">
        <button v-for="cell in cells" :key="cell.n" type="button" class="pair-line" :data-at="cell.at"
                :aria-current="cell.n === chosen ? 'true' : undefined" :tabindex="cell.at === focused ? 0 : -1"
                :style="{ top: cell.at * line + 'px' }" @click="open(cell.at)" @focus="focused = cell.at">
          <span class="pair-name">{{ cell.id }}</span>
          <span class="pair-change">{{ cell.text }}</span>
        </button>
      </div>
    </div>`,
  props: { source: String, chosen: Number },
  data() {
    return { rows: null, problem: "", top: 0, height: 600, focused: 0, line: LINE };
  },
  computed: {
    cells() {
      const first = Math.max(0, Math.floor(this.top / LINE) - OVERSCAN);
      const count = Math.ceil(this.height / LINE) + 2 * OVERSCAN;
      return this.rows.slice(first, first + count).map(([n, id, text], k) => ({ n, id, text, at: first + k }));
    },
  },
  watch: {
    source() {
      this.load();
    },
  },
  mounted() {
    this.observer = new ResizeObserver(() => this.measure());
    this.observer.observe(this.$refs.box);
    this.measure();
    this.load();
  },
  unmounted() {
    this.observer.disconnect();
  },
  methods: {
    async load() {
      const source = this.source;
      try {
        const answer = await fetch(source);
        if (!answer.ok) throw new Error(await answer.text());
        const found = await answer.json();
        if (source !== this.source) return;
        this.rows = Object.freeze(found);
        this.problem = "";
        const at = found.findIndex(([n]) => n === this.chosen);
        this.focused = at >= 0 ? at : 0;
      } catch (error) {
        this.problem = `The frames cannot be read: ${error.message}`;
      }
    },
    measure() {
      if (this.$refs.box) this.height = this.$refs.box.clientHeight;
    },
    scrolled() {
      this.top = this.$refs.box.scrollTop;
    },
    open(at) {
      this.focused = at;
      this.$emit("open", { n: this.rows[at][0] });
    },
    step(by) {
      if (!this.rows || !this.rows.length) return;
      const at = this.rows.findIndex(([n]) => n === this.chosen);
      const next = Math.max(0, Math.min(this.rows.length - 1, (at < 0 ? -by : at) + by));
      this.reveal(next);
      this.open(next);
    },
    reveal(at) {
      this.focused = Math.max(0, Math.min(this.rows.length - 1, at));
      const box = this.$refs.box, top = this.focused * LINE;
      if (top < box.scrollTop) box.scrollTop = top;
      if (top + LINE > box.scrollTop + box.clientHeight) box.scrollTop = top + LINE - box.clientHeight;
      this.top = box.scrollTop;
    },
    keyed(event) {
      if (!this.rows || event.ctrlKey || event.metaKey || event.altKey) return;
      const page = Math.max(1, Math.floor(this.height / LINE) - 1);
      const steps = { ArrowDown: 1, ArrowUp: -1, PageDown: page, PageUp: -page, Home: -Infinity, End: Infinity };
      if (!(event.key in steps)) return;
      event.preventDefault();
      event.stopPropagation();
      this.reveal(this.focused + steps[event.key]);
      this.$nextTick(() => this.$refs.box.querySelector(`[data-at="${this.focused}"]`)?.focus({ preventScroll: true }));
    },
  },
};
