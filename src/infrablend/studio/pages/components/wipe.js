// Two pictures over each other with a divider: drag it, or focus it and use the arrow keys.
export default {
  template: `
    <div class="wipe">
      <img class="picture" :src="b" :alt="names[1] + ', right of the divider'" draggable="false">
      <img class="picture wipe-top" :src="a" :alt="names[0] + ', left of the divider'" draggable="false"
           :style="{ clipPath: 'inset(0 ' + (100 - at) + '% 0 0)' }">
      <input type="range" min="0" max="100" step="1" v-model.number="at" aria-label="Divider"
             :aria-valuetext="at + ' % ' + names[0]">
      <span class="wipe-line" :style="{ left: at + '%' }" aria-hidden="true"></span>
      <span class="wipe-name wipe-left" aria-hidden="true">A</span>
      <span class="wipe-name wipe-right" aria-hidden="true">B</span>
    </div>`,
  props: { a: String, b: String, names: Array },
  data() {
    return { at: 50 };
  },
};
