// HTML as the server writes it. An element of NiceGUI's own would have the whole page laid out again at each change.
export default {
  template: "<div></div>",
  methods: {
    draw(html, key) {
      const left = this.$el.querySelector(".scroll")?.scrollLeft;
      this.$el.innerHTML = html;
      if (left) this.$el.querySelector(".scroll").scrollLeft = left;
      this.$el.dataset.drawn = key;
    },
  },
};
