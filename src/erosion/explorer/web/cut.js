// The cut in motion, drawn to scale: target, removed area, path of the tip, and the turning particle.
// An angular grain: each corner is (angle from the tip, distance from the centre of mass divided by r).
const GRAIN = [[0, 1], [52, 0.78], [108, 0.95], [163, 0.8], [221, 0.97], [300, 0.8]];
const GHOSTS = [0, 0.25, 0.5, 0.75, 1];
const SECONDS = 5; // duration of the animation of a whole cut
const REST = 200; // ms; after this time without a change, the link holds the instant shown

export default {
  template: `<div class="cut">
    <svg ref="svg" :viewBox="box.join(' ')" role="img" :aria-label="label" preserveAspectRatio="xMidYMid meet">
      <rect class="target" :x="box[0]" y="0" :width="box[2]" :height="Math.max(0, box[1] + box[3])" />
      <polygon class="all" :points="area(1)" /><polygon class="removed" :points="area(fraction)" />
      <line class="surface" :x1="box[0]" :x2="box[0] + box[2]" y1="0" y2="0" />
      <clipPath id="cut-open"><rect :x="box[0]" :y="box[1]" :width="box[2]" :height="Math.max(0, -box[1])" />
        <polygon :points="area(fraction)" /></clipPath>
      <g clip-path="url(#cut-open)"><polygon v-for="g in ghosts" :key="g" class="ghost" :points="grain(g)" /></g>
      <polyline class="path" :points="path()" />
      <g clip-path="url(#cut-open)"><polygon class="grain" :points="grain(fraction)" /></g>
      <line class="arm" v-bind="arm()" /><circle class="mass" v-bind="mass()" :r="size * 0.05" />
      <circle class="tip" v-bind="tip()" :r="size * 0.05" />
      <g v-for="arrow in arrows()" :key="arrow.name" :class="['arrow', arrow.name]"><line v-bind="arrow.line" />
        <polygon :points="arrow.head" /><text :x="arrow.at[0]" :y="arrow.at[1]" :font-size="letters" :text-anchor="arrow.anchor">{{ arrow.text }}</text></g>
      <g v-if="bar" class="bar" :transform="'translate(' + (box[0] + box[2] * 0.98 - bar.size) + ' ' + (box[1] + box[3] * 0.93) + ')'">
        <line x1="0" :x2="bar.size" y1="0" y2="0" />
        <text :x="bar.size" :y="-box[3] * 0.025" :font-size="letters" text-anchor="end">{{ bar.text }}</text></g>
    </svg>
    <div class="cut-time"><button type="button" class="cut-play" @click="toggle" :aria-label="playing ? 'Pause' : 'Play'"
      :disabled="!moves"><svg viewBox="0 0 24 24" aria-hidden="true"><path :d="playing ? 'M6 5h4v14H6zM14 5h4v14h-4z' : 'M8 5v14l11-7z'"/></svg></button>
      <input type="range" min="0" max="1" step="0.005" :value="fraction" aria-label="Time in the cut" :aria-valuetext="time"
        :disabled="!moves" @input="scrub"><output>{{ time }}</output></div>
    <div v-if="energy" class="cut-energy" role="img" :aria-label="'energy: ' + shares().map((s) => s.text).join(', ')">
      <div><span v-for="share in shares()" :key="share.name" :class="share.name" :style="{ flexGrow: share.part }"></span></div>
      <ul><li v-for="share in shares()" :key="share.name"><i :class="share.name"></i>{{ share.text }}</li></ul></div></div>`,
  props: { instant: Number },
  data: (own) => ({
    t: [], x: [], depth: [], phi: [], size: 1, unit: 1, units: "", label: "", bar: null, velocity: null, force: null,
    energy: null, names: {}, box: [0, 0, 1, 1],
    fraction: own.instant, playing: false, letters: 0.1,
  }),
  computed: {
    moves() { return this.t.length > 1; },
    ghosts() { return this.moves ? GHOSTS : []; },
    time() {
      const end = this.t.length ? this.t[this.t.length - 1] : 0;
      return `t = ${((this.fraction * end) / this.unit).toFixed(2)} ${this.units}`;
    },
  },
  mounted() {
    this.sizes = new ResizeObserver(() => this.frame());
    this.sizes.observe(this.$refs.svg);
  },
  beforeUnmount() { this.sizes.disconnect(); clearTimeout(this.rest); cancelAnimationFrame(this.request); },
  methods: {
    draw(cut, key) {
      Object.assign(this, cut);
      this.frame();
      this.tell();
      requestAnimationFrame(() => {
        this.$el.dataset.drawn = key;
        this.$el.dispatchEvent(new CustomEvent("drawn", { detail: key }));
      });
    },
    frame() {
      if (!this.x.length) return;
      // Leave room for the grain at both ends, and fit the picture's shape on the page.
      let left = Math.min(...this.x) - 1.3 * this.size, right = Math.max(...this.x) + 1.5 * this.size;
      let top = -2.15 * this.size, foot = Math.max(...this.depth) + 0.75 * this.size;
      const { width, height } = this.$refs.svg.getBoundingClientRect();
      const shape = height > 0 ? width / height : 2;
      if ((right - left) / (foot - top) < shape) {
        const more = (shape * (foot - top) - (right - left)) / 2;
        left -= more; right += more;
      } else {
        const more = (right - left) / shape - (foot - top);
        top -= more * 0.4; foot += more * 0.6;
      }
      this.box = [left, top, right - left, foot - top];
      this.letters = (14 * (right - left)) / Math.max(width, 1);
    },
    place(fraction) {
      const place = fraction * (this.t.length - 1);
      return { place, i: Math.min(Math.floor(place), Math.max(this.t.length - 2, 0)) };
    },
    mix(all, fraction) {
      const { place, i } = this.place(fraction);
      return i + 1 < all.length ? all[i] + (place - i) * (all[i + 1] - all[i]) : all[0] ?? 0;
    },
    at(fraction) {
      const [x, y, phi] = [this.x, this.depth, this.phi].map((all) => this.mix(all, fraction));
      return { i: this.place(fraction).i, x, y, phi };
    },
    grain(fraction) {
      const { x, y, phi } = this.at(fraction), r = this.size;
      const middle = [x + r * Math.cos(phi), y - r * Math.sin(phi)];
      return GRAIN.map(([angle, distance]) => {
        // The tip lies in the direction φ + π from the centre of mass.
        const way = phi + Math.PI + (angle * Math.PI) / 180;
        return `${middle[0] + distance * r * Math.cos(way)},${middle[1] - distance * r * Math.sin(way)}`;
      }).join(" ");
    },
    area(fraction) {
      const { i, x, y } = this.at(fraction), points = [];
      for (let n = 0; n <= i; n++) points.push(`${this.x[n]},${this.depth[n]}`);
      return [...points, `${x},${y}`, `${x},0`, `${this.x[0] ?? 0},0`].join(" ");
    },
    path() { return this.x.map((x, n) => `${x},${this.depth[n]}`).join(" "); },
    tip() { const { x, y } = this.at(this.fraction); return { cx: x, cy: y }; },
    mass() {
      const { x, y, phi } = this.at(this.fraction);
      return { cx: x + this.size * Math.cos(phi), cy: y - this.size * Math.sin(phi) };
    },
    // A vector of the centre of mass or of the tip, at most 1.1 r long; y is down, as in the picture.
    arrows() {
      if (!this.velocity || !this.moves) return [];
      const a = this.mass(), b = this.tip();
      return [["velocity", this.velocity, a.cx, a.cy, "velocity"], ["force", this.force, b.cx, b.cy, "force on the tip"]]
        .flatMap(([name, of, x, y, text]) => {
          const [u, v] = of.map((part) => this.mix(part, this.fraction) * 1.1 * this.size), length = Math.hypot(u, v);
          const head = 0.14 * this.size, [du, dv] = [u / length, v / length];
          if (length <= head) return [];
          const end = [x + u, y + v], foot = [end[0] - head * du, end[1] - head * dv];
          return [{
            name, text: length > 2 * head ? text : "", anchor: u < 0 ? "end" : "start",
            at: [end[0] + Math.sign(u) * 0.06 * this.size, end[1] - 0.06 * this.size],
            line: { x1: x, y1: y, x2: foot[0], y2: foot[1] },
            head: [end, [foot[0] - head * dv / 2, foot[1] + head * du / 2],
              [foot[0] + head * dv / 2, foot[1] - head * du / 2]].map((point) => point.join(",")).join(" "),
          }];
        });
    },
    shares() {
      return Object.entries(this.names).map(([name, words], i) => {
        const part = Math.max(0, this.mix(this.energy[i], this.fraction));
        return { name, part, text: `${words} ${(100 * part).toFixed(0)} %` };
      });
    },
    arm() { const a = this.tip(), b = this.mass(); return { x1: a.cx, y1: a.cy, x2: b.cx, y2: b.cy }; },
    scrub(event) { this.playing = false; this.fraction = Number(event.target.value); this.tell(); this.stay(); },
    stay() {
      clearTimeout(this.rest);
      this.rest = setTimeout(() => this.$emit("instant", this.fraction), REST);
    },
    toggle() {
      this.playing = !this.playing;
      if (!this.playing) return this.stay();
      if (this.fraction >= 1) this.fraction = 0;
      let before = performance.now();
      const step = (now) => {
        if (!this.playing) return;
        this.fraction = Math.min(1, this.fraction + (now - before) / 1000 / SECONDS);
        before = now;
        this.tell();
        if (this.fraction >= 1) { this.playing = false; this.stay(); }
        else this.request = requestAnimationFrame(step);
      };
      this.request = requestAnimationFrame(step);
    },
    tell() {
      const end = this.t.length ? this.t[this.t.length - 1] : 0;
      window.dispatchEvent(new CustomEvent("cut-time", { detail: this.fraction * end }));
    },
  },
};
