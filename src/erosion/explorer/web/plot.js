// A plot (by the ECharts that NiceGUI brings) with vertical handles, which mouse, finger or keyboard can move.
import { echarts } from "nicegui-echart";

const variable = (name) => getComputedStyle(document.body).getPropertyValue(name).trim();

const isDark = () => document.body.classList.contains("body--dark");

function theme() {
  const ink = variable("--ink"), faint = variable("--faint"), dim = variable("--dim");
  const axis = {
    axisLine: { show: true, lineStyle: { color: dim } },
    axisTick: { lineStyle: { color: dim } },
    axisLabel: { color: ink, fontSize: 13 },
    splitLine: { lineStyle: { color: faint } },
    nameTextStyle: { color: ink, fontSize: 13 },
  };
  return {
    backgroundColor: "transparent",
    // A canvas does not know the colour "inherit".
    textStyle: { color: ink, fontFamily: getComputedStyle(document.body).fontFamily },
    valueAxis: axis,
    categoryAxis: axis,
    legend: { textStyle: { color: ink, fontSize: 13 } },
    title: { textStyle: { color: ink } },
    tooltip: {
      backgroundColor: variable("--surface"), borderColor: dim, textStyle: { color: ink, fontSize: 13 },
    },
  };
}

export default {
  template: `<div class="plot" :style="{'--plot-height': height}">
    <ul v-if="legend.length" class="plot-legend"><li v-for="one in legend" :key="one.name"><svg viewBox="0 0 26 12" aria-hidden="true">
      <rect v-if="one.area" width="26" height="12" :fill="one.color" :opacity="one.area" />
      <circle v-else-if="one.hollow" cx="13" cy="6" r="4.5" fill="none" :stroke="one.color" stroke-width="1.6" />
      <line v-else x2="26" y1="6" y2="6" :stroke="one.color" stroke-width="2.4" :stroke-dasharray="one.dashes" /></svg>{{ one.name }}</li></ul>
    <p v-if="names.y" class="plot-name"><component :is="i % 2 ? 'sub' : 'span'" v-for="(part, i) in names.y" :key="i">{{ part }}</component></p>
    <div ref="area" class="plot-area"><div ref="chart" class="plot-chart" role="img" :aria-label="label"></div>
    <div v-for="(h, i) in handles" :key="i" ref="handle" class="plot-handle" :class="{fixed: !h.movable}"
      :role="h.movable ? 'slider' : 'presentation'" :tabindex="h.movable ? 0 : -1"
      :aria-label="h.label" :aria-valuemin="h.low" :aria-valuemax="h.high" :aria-valuenow="h.x" :aria-valuetext="h.text"
      :style="place(h)" @pointerdown="grab($event, h)" @pointermove="move($event, h)" @pointerup="held = null"
      @pointercancel="held = null" @keydown="key($event, h)"><span v-if="h.movable" class="plot-grip"></span></div></div>
    <p v-if="names.x" class="plot-name plot-name-x"><component :is="i % 2 ? 'sub' : 'span'" v-for="(part, i) in names.x" :key="i">{{ part }}</component></p></div>`,
  props: { height: String, follows: Boolean },
  data: () => ({ handles: [], legend: [], names: {}, label: "", held: null, layout: 0 }),
  mounted() {
    this.chart = echarts.init(this.$refs.chart, theme());
    this.$el.chart = this.chart;
    this.sizes = new ResizeObserver(() => { this.chart.resize(); this.layout++; });
    this.sizes.observe(this.$refs.area);
    this.dark = isDark();
    this.scheme = new MutationObserver(() => {
      if (this.dark === isDark()) return;
      this.dark = isDark();
      this.chart.setTheme(theme());
      // With a new theme ECharts shows the first option again that it was ever given.
      if (this.option) this.chart.setOption(this.option, true);
      this.layout++;
    });
    this.scheme.observe(document.body, { attributes: true, attributeFilter: ["class"] });
    this.follow = (event) => {
      this.now = event.detail;
      this.handles.forEach((h) => { if (!h.movable) h.x = this.now / h.unit; });
    };
    if (this.follows) window.addEventListener("cut-time", this.follow);
  },
  beforeUnmount() {
    window.removeEventListener("cut-time", this.follow);
    this.sizes.disconnect();
    this.scheme.disconnect();
    this.chart.dispose();
  },
  methods: {
    draw(option, handles, label, key) {
      if (option) {
        this.take_words(option);
        this.chart.setOption(option, { replaceMerge: ["series"] });
        this.option = option;
      }
      this.handles = handles.map((h, index) => {
        // A handle that is being dragged stays; a handle that follows the cut stays at the time of the cut.
        if (this.held === index) return { ...h, index, x: this.handles[index].x };
        return { ...h, index, x: h.movable || this.now === undefined ? h.x : this.now / h.unit };
      });
      this.label = label;
      this.layout++;
      requestAnimationFrame(() => {
        this.$el.dataset.drawn = key;
        this.$el.dispatchEvent(new CustomEvent("drawn", { detail: key }));
      });
    },
    // Beside the canvas, which cuts what is too long, names and the legend have as many lines as they need.
    take_words(option) {
      const taken = (axis) => {
        const name = axis?.name;
        if (name) delete axis.name;
        return name?.split(/_([^\s_]+)/);
      };
      this.names = { x: taken(option.xAxis), y: taken(option.yAxis) };
      // Four panels have curves of the same names.
      const drawn = [...new Map(option.series.map((one) => [one.legend ?? one.name, one])).values()]
        .filter((one) => one.type !== "bar").sort((one, other) => Boolean(one.legend) - Boolean(other.legend));
      this.legend = drawn.map(({ name, legend, type, itemStyle, lineStyle, areaStyle }) => ({
        name: legend ?? name, area: areaStyle?.opacity, hollow: type === "scatter",
        color: legend ? "currentColor" : itemStyle.borderColor ?? itemStyle.color,
        dashes: lineStyle?.type === "dashed" ? "6 4" : Array.isArray(lineStyle?.type) ? lineStyle.type.join(" ") : null,
      }));
    },
    grid(h) {
      return this.chart.getModel().getComponent("grid", h.grid || 0).coordinateSystem.getRect();
    },
    place(h) {
      this.layout; // read here, so that Vue places the handles again after a new layout
      if (!this.option) return {};
      const x = this.chart.convertToPixel({ gridIndex: h.grid || 0 }, [h.x, 0])[0], box = this.grid(h);
      const shown = Number.isFinite(x) && x > box.x - 1 && x < box.x + box.width + 1;
      return { left: `${x}px`, top: `${box.y}px`, height: `${box.height}px`, display: shown ? "block" : "none" };
    },
    grab(event, h) {
      if (!h.movable) return;
      event.target.setPointerCapture(event.pointerId);
      this.held = h.index;
    },
    move(event, h) {
      if (this.held !== h.index || !h.movable) return;
      const left = event.clientX - this.$refs.chart.getBoundingClientRect().left;
      this.pick(h, this.chart.convertFromPixel({ gridIndex: h.grid || 0 }, [left, 0])[0]);
    },
    key(event, h) {
      const steps = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1, PageUp: 20, PageDown: -20 }[event.key];
      if (!h.movable || !steps) return;
      event.preventDefault();
      this.pick(h, h.x + steps * h.step);
    },
    pick(h, x) {
      h.x = Math.min(h.high, Math.max(h.low, Math.round(x / h.step) * h.step));
      this.$emit("pick", h.x);
    },
  },
};
