// Legend: a field and its values in; colours, limits and what is hidden out, and their explanation on the page.

// Dark ends, which would be lost on the background, are cut off; the same maps as in the pictures of `render`.
const MAPS = {
  viridis: "472a7a 443b84 3e4c8a 375b8d 306a8e 2a778e 25848e 20928c 1f9f88 "
    + "25ac82 37b878 50c46a 6ece58 90d743 b5de2b dae319 fde725",
  turbo: "a91601 cc2b04 e5470b f66c19 fe962b faba39 e7d739 c8ef34 a4fc3c "
    + "71fe5f 3cf58e 1ae4b6 1ecbda 35abf8 4687fb 4664da 3f3e9c",
  inferno: "6a176e 7d1e6d 8f2469 a02a63 b1325a c13a50 d24644 df5337 ea632a "
    + "f2741c f8870e fb9d07 fcb216 f9c72f f4dd4f f1f179 fcffa4",
};
// As PALETTE of cloud/shades.py: apart for deuteranopes too, from each other, from NONE and from false alarms.
const KINDS = "f09669 0069ff fff000 a5ffe1 00a5ff 2d874b ff6900 c3ff69 78780f fff0b4 f078a5 e1d2ff".split(" ");
const NONE = [107, 114, 128];

const bytesOf = hex => [0, 2, 4].map(i => parseInt(hex.slice(i, i + 2), 16));

function createElement(tag, attributes = {}, ...children) {
  const element = Object.assign(document.createElement(tag), attributes);
  element.append(...children);
  return element;
}

// A number in its unit: with a prefix where the unit takes one.
function formatted(value, unit, digits = 4) {
  if (!Number.isFinite(value)) return "none";
  // How sure a detection is stands behind the nines.
  if (value < 1 && Number(value.toPrecision(digits)) === 1) return `1 − ${(1 - value).toExponential(1)}`;
  if (value === 0 || !["W", "A", "s"].includes(unit)) {
    const text = Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-3)
      ? value.toExponential(digits - 1) : String(Number(value.toPrecision(digits)));
    return unit ? `${text}\u202f${unit}` : text;
  }
  const power = Math.max(-5, Math.min(1, Math.floor(Math.log10(Math.abs(value)) / 3)));
  return `${Number((value / 1000 ** power).toPrecision(digits))}\u202f${"fpnµm k"[power + 5].trim()}${unit}`;
}

// A number as it is typed.
const typed = value => value !== 0 && Math.abs(value) < 1e-3 ? value.toExponential(2) : String(Number(value.toPrecision(4)));

class Legend {
  constructor(element, changed) {
    Object.assign(this, { element, changed, field: null, off: new Set() });
  }

  // `keep`: limits and hidden kinds stay if the field is the one that was shown, of some points.
  show(field, values, keep) {
    const same = keep && this.values?.length > 0 && this.field.name === field.name && this.field.unit === field.unit;
    [this.field, this.values] = [field, values];
    if (!same) {
      this.log = field.log;
      this.off = new Set();
      this.fit();
    }
    this.build();
  }

  get isCategory() {
    return this.field.names !== null;
  }

  get style() {
    return { low: this.low, high: this.high, scale: this.isCategory ? 2 : this.log ? 1 : 0 };
  }

  isShown(i) {
    return !(this.isCategory && this.off.has(this.values[i]));
  }

  // Limits from the 1st to the 99th percentile.
  fit() {
    if (this.isCategory) return;
    const finite = this.values.filter(value => Number.isFinite(value) && (value > 0 || !this.log)).sort();
    const at = part => finite.length ? finite[Math.round(part * (finite.length - 1))] : this.log ? 0.1 : 0;
    const rounded = value => Number(value.toPrecision(4));
    [this.low, this.high] = [rounded(at(0.01)), rounded(at(0.99))];
    if (this.field.name === "detection_probability") [this.low, this.high] = [0, 1];
    if (!(this.high > this.low)) this.high = this.log ? 2 * this.low : this.low + 1;
  }

  // Colours as 256 a row, (r, g, b, a): of a number by its part of the scale, of a kind by its number and one.
  get map() {
    if (this.isCategory) {
      const colours = [NONE, ...this.field.names.map((_, i) => bytesOf(KINDS[i % KINDS.length]))];
      const bytes = new Uint8Array(1024 * Math.ceil(colours.length / 256));
      colours.forEach((colour, i) => bytes.set([...colour, this.off.has(i - 1) ? 0 : 255], 4 * i));
      return bytes;
    }
    const name = this.field.name;
    const stops = MAPS[name === "range" || name === "true_range" ? "turbo" : this.field.log ? "inferno" : "viridis"]
      .split(" ").map(bytesOf);
    const bytes = new Uint8Array(1024);
    for (let i = 0; i < 256; i++) {
      const place = i / 255 * (stops.length - 1), k = Math.min(Math.floor(place), stops.length - 2);
      bytes.set([...stops[k].map((c, j) => Math.round(c + (place - k) * (stops[k + 1][j] - c))), 255], 4 * i);
    }
    return bytes;
  }

  build() {
    const { label, unit, meaning } = this.field;
    const title = createElement("div", { title: meaning }, createElement("b", {}, label), unit ? ` [${unit}]` : "");
    this.element.replaceChildren(title, ...(this.isCategory ? [this.#kinds()] : this.#scale()));
  }

  #scale() {
    const bar = createElement("canvas", { width: 256, height: 1 });
    bar.getContext("2d").putImageData(new ImageData(new Uint8ClampedArray(this.map), 256, 1), 0, 0);
    const part = value => this.log ? Math.log(value / this.low) / Math.log(this.high / this.low)
      : (value - this.low) / (this.high - this.low);
    const ticks = createElement("div", { className: "ticks" });
    for (const tick of this.#ticks()) {
      const text = createElement("span", {}, formatted(tick, ["W", "A"].includes(this.field.unit) ? this.field.unit : "", 3));
      const place = Math.max(0, Math.min(1, part(tick)));
      // Texts at the ends stay within the bar.
      Object.assign(text.style, { left: `${100 * place}%`, transform: `translateX(${-100 * place}%)` });
      ticks.append(text);
    }
    const limit = key => createElement("input", {
      type: "number", step: "any", value: typed(this[key]), ariaLabel: `${key}est of the scale`,
      onchange: event => this.#limit(key, event.target.valueAsNumber),
    });
    const log = createElement("input", { type: "checkbox", checked: this.log, onchange: () => {
      this.log = !this.log;
      this.fit();
      this.#report();
    } });
    const fit = createElement("button", { type: "button", onclick: () => {
      this.fit();
      this.#report();
    } }, "fit");
    return [bar, ticks, createElement("div", { className: "limits" }, limit("low"), limit("high"), fit, createElement("label", {}, log, "log"))];
  }

  #limit(key, value) {
    const limits = { low: this.low, high: this.high, [key]: value };
    if (limits.high > limits.low && (limits.low > 0 || !this.log)) Object.assign(this, limits);
    this.#report();
  }

  #report() {
    this.build();
    this.changed();
  }

  #ticks() {
    const { low, high, log } = this;
    if (log) {
      const rounded = [];
      for (let p = Math.floor(Math.log10(low)); 10 ** p <= high; p++) rounded.push(...[1, 2, 5].map(n => n * 10 ** p));
      const inside = rounded.filter(tick => tick >= 0.999 * low && tick <= 1.001 * high);
      const decades = inside.filter(tick => Math.abs(Math.log10(tick) % 1) < 1e-9);
      const few = decades.length > 2 ? decades : inside;
      if (few.length > 2) return few.filter((_, i) => i % Math.ceil(few.length / 5) === 0);
    }
    const raw = (high - low) / 4, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 5, 10].find(n => n * power >= raw);
    const ticks = [];
    for (let n = Math.ceil(low / step - 1e-9); n * step <= high + 1e-9 * step; n++) ticks.push(n * step);
    return ticks;
  }

  // Kinds that are there, most frequent first; a click hides one and shows it again.
  #kinds() {
    const counts = new Map();
    for (const value of this.values) counts.set(value, (counts.get(value) ?? 0) + 1);
    const rows = [...counts].sort((a, b) => b[1] - a[1]).map(([value, count]) => {
      const dot = createElement("i");
      dot.style.background = value < 0 ? `rgb(${NONE})` : `#${KINDS[value % KINDS.length]}`;
      const name = value < 0 ? "none" : this.field.names[value] ?? String(value);
      return createElement("button", { type: "button", ariaPressed: String(!this.off.has(value)), onclick: () => {
        if (!this.off.delete(value)) this.off.add(value);
        this.#report();
      } }, dot, name, createElement("em", {}, count.toLocaleString("en")));
    });
    return createElement("div", { className: "kinds" }, ...rows);
  }
}
