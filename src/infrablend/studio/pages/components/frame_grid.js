// A grid of frames that keeps only the visible cells in the page, so that 10,000 frames scroll like 50.
// The place in it is kept in the browser's history, and each frame that is opened has an entry of its own there.
const GAP = 8, CAPTION = 40, OVERSCAN = 2, QUIET_MS = 150;
const WORDS = { accept: "accepted", reject: "rejected" };

export default {
  template: `
    <div ref="box" class="frame-grid" role="group" aria-label="Frames" tabindex="-1" @scroll.passive="scrolled">
      <p v-if="problem" class="frame-grid-note" role="alert">{{ problem }}</p>
      <p v-else-if="rows && !rows.length" class="frame-grid-note">No frame has all of these properties.</p>
      <p v-else-if="!rows" class="frame-grid-note">Reading the frames...</p>
      <div v-if="rows" :style="{ height: lines * lineHeight + 'px', position: 'relative' }">
        <button v-for="cell in cells" :key="cell.n" type="button" class="frame-cell" :data-at="cell.at"
                :data-verdict="cell.verdict" :tabindex="cell.at === focused ? 0 : -1" :style="cell.style"
                @click="open(cell.at)" @focus="focused = cell.at">
          <img :src="cell.src" alt="" draggable="false" decoding="async">
          <span class="frame-name">{{ cell.id }}</span>
          <span class="frame-verdict" v-if="cell.verdict">{{ cell.word }}</span>
        </button>
      </div>
    </div>`,
  props: { source: String },
  data() {
    return { rows: null, problem: "", top: 0, height: 600, width: 800, focused: 0, loaded: 0 };
  },
  computed: {
    columns() {
      return Math.max(2, Math.floor((this.width + GAP) / (200 + GAP)));
    },
    cellWidth() {
      return (this.width - GAP * (this.columns - 1)) / this.columns;
    },
    lineHeight() {
      return Math.round(this.cellWidth * 0.8) + CAPTION + GAP;
    },
    lines() {
      return Math.ceil(this.rows.length / this.columns);
    },
    cells() {
      const first = Math.max(0, Math.floor(this.top / this.lineHeight) - OVERSCAN) * this.columns;
      const shown = (Math.ceil(this.height / this.lineHeight) + 2 * OVERSCAN) * this.columns;
      return this.rows.slice(first, first + shown).map(([n, id, digest, verdict], k) => {
        const at = first + k;
        const word = WORDS[verdict] || "";
        return {
          n, at, id, verdict, word,
          src: `/run/thumb/${n}.jpg?d=${digest || this.loaded}`,
          style: {
            left: (at % this.columns) * (this.cellWidth + GAP) + "px",
            top: Math.floor(at / this.columns) * this.lineHeight + "px",
            width: this.cellWidth + "px",
            height: this.lineHeight - GAP + "px",
          },
        };
      });
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
    addEventListener("keydown", this.keyed);
    addEventListener("popstate", this.moved);
    this.measure();
    this.load();
  },
  unmounted() {
    this.observer.disconnect();
    removeEventListener("keydown", this.keyed);
    removeEventListener("popstate", this.moved);
    clearTimeout(this.timer);
    clearTimeout(this.keeping);
  },
  methods: {
    async load() {
      const source = this.source;
      try {
        const answer = await fetch(source);
        if (!answer.ok) throw new Error(await answer.text());
        const { rows: found, complete } = await answer.json();
        if (source !== this.source) return;
        clearTimeout(this.timer);
        this.loaded = Date.now();
        if (!complete) this.timer = setTimeout(() => this.load(), 1000);
        const isFirst = !this.rows;
        this.rows = Object.freeze(found);
        this.problem = "";
        if (isFirst) this.$nextTick(this.begin);
        this.focused = Math.min(this.focused, Math.max(0, found.length - 1));
        this.$emit("loaded", { count: found.length });
      } catch (error) {
        this.problem = `The frames cannot be read: ${error.message}`;
      }
    },
    mark(n, verdict) {
      if (!this.rows) return;
      this.rows = Object.freeze(this.rows.map((row) => (row[0] === n ? [row[0], row[1], row[2], verdict] : row)));
    },
    measure() {
      const box = this.$refs.box;
      if (!box || !box.clientWidth) return;
      this.width = box.clientWidth;
      this.height = box.clientHeight;
    },
    begin() {
      // Where it was when the page was left or loaded again; keys work at once.
      const { top = 0, focused = 0 } = history.state || {};
      const box = this.$refs.box;
      box.scrollTop = this.top = top;
      if (!box.clientHeight || document.activeElement !== document.body) return;
      this.focus(this.isVisible(focused) ? focused : this.first());
    },
    scrolled() {
      if (!this.$refs.box.clientHeight) return; // hidden by a frame
      this.top = this.$refs.box.scrollTop;
      clearTimeout(this.keeping);
      this.keeping = setTimeout(this.keep, QUIET_MS);
    },
    keep() {
      clearTimeout(this.keeping);
      if (!this.$refs.box?.clientHeight) return;
      history.replaceState({ ...history.state, top: this.top, focused: this.focused }, "");
    },
    moved() {
      this.$emit("moved", { frame: new URLSearchParams(location.search).get("frame") || "" });
    },
    address(url, isNew) {
      if (isNew) history.pushState({ opened: true, top: this.top, focused: this.focused }, "", url);
      else history.replaceState(history.state, "", url);
    },
    leave(url) {
      // Back, if the frame was opened from the list; else its entry becomes the list's.
      if (history.state?.opened) history.back();
      else this.address(url, false);
    },
    first() {
      return Math.min(this.rows.length - 1, Math.ceil(this.top / this.lineHeight) * this.columns);
    },
    isVisible(at) {
      const top = Math.floor(at / this.columns) * this.lineHeight;
      return top + this.lineHeight > this.top && top < this.top + this.height;
    },
    open(at) {
      this.focused = at;
      this.keep();
      this.$emit("open", { n: this.rows[at][0] });
    },
    reveal(n) {
      if (!this.rows) return;
      const at = this.rows.findIndex((row) => row[0] === n), top = this.top;
      this.measure(); // of what a frame has hidden, neither the size nor the place is known
      this.$nextTick(() => {
        this.$refs.box.scrollTop = this.top = top;
        if (at >= 0) this.focus(at);
      });
    },
    focus(at) {
      this.focused = Math.max(0, Math.min(this.rows.length - 1, at));
      const box = this.$refs.box, top = Math.floor(this.focused / this.columns) * this.lineHeight;
      if (top < box.scrollTop) box.scrollTop = top;
      if (top + this.lineHeight > box.scrollTop + box.clientHeight) box.scrollTop = top + this.lineHeight - box.clientHeight;
      this.top = box.scrollTop;
      this.$nextTick(() => box.querySelector(`[data-at="${this.focused}"]`)?.focus({ preventScroll: true }));
    },
    keyed(event) {
      const box = this.$refs.box, active = document.activeElement;
      if (!this.rows?.length || !box.clientHeight || event.ctrlKey || event.metaKey || event.altKey) return;
      if (active !== document.body && !box.contains(active)) return;
      const page = this.columns * Math.max(1, Math.floor(this.height / this.lineHeight));
      const steps = {
        ArrowRight: 1, ArrowLeft: -1, ArrowDown: this.columns, ArrowUp: -this.columns,
        PageDown: page, PageUp: -page, Home: -Infinity, End: Infinity,
      };
      if (!(event.key in steps)) return;
      event.preventDefault();
      // A cell that has been scrolled away is not where the eyes are.
      this.focus(this.isVisible(this.focused) ? this.focused + steps[event.key] : this.first());
    },
  },
};
