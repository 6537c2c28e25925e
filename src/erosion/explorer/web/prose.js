// HTML from the server. NiceGUI's own element would lay out the whole page again at each change.
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
