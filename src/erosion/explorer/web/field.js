// One parameter: an entry for its number and a slider. Both are native, so keyboards and screen readers can use them.
export default {
  template: `<div class="field" :class="{wrong: why}">
    <label class="field-name" :for="id + '-entry'"><b>{{ symbol }}</b> {{ meaning }}</label>
    <span class="field-entry"><input :id="id + '-entry'" v-model="text" type="text" inputmode="text" autocomplete="off"
      spellcheck="false" :aria-invalid="why ? 'true' : 'false'" :aria-describedby="id + '-why'"
      @focus="typing = true" @blur="commit" @keydown.enter="commit" @keydown.esc="restore"><span
      class="field-unit">{{ unit }}</span></span>
    <input :id="id + '-slider'" ref="slider" type="range" :min="low" :max="high" :step="step" :value="at"
      :aria-label="meaning" :aria-valuetext="(shown + ' ' + unit).trim()" @input="slide">
    <p :id="id + '-why'" class="field-why" role="alert">{{ why }}</p></div>`,
  props: { id: String, symbol: String, meaning: String, low: Number, high: Number, step: Number },
  data: () => ({ text: "", shown: "", unit: "", at: 0, why: "", typing: false }),
  methods: {
    show(text, unit, at) {
      this.shown = text;
      this.unit = unit;
      this.why = "";
      if (!this.typing) this.text = text;
      // While the reader drags the slider, its position is newer than the server's.
      if (document.activeElement !== this.$refs.slider || !this.sliding) this.at = at;
    },
    complain(why) { this.why = why; },
    slide(event) {
      this.at = Number(event.target.value);
      this.sliding = true;
      clearTimeout(this.rest);
      this.rest = setTimeout(() => (this.sliding = false), 400);
      this.$emit("slide", this.at);
    },
    commit() {
      this.typing = false;
      if (this.text.trim() === this.shown) return this.restore();
      this.$emit("entry", this.text.trim());
    },
    restore() {
      this.typing = false;
      this.text = this.shown;
      this.why = "";
    },
  },
};
