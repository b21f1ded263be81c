// Viewer: the stage and its frames, put together. `viewer` is there for whoever opens the console.

class Viewer {
  constructor(stage) {
    this.stage = stage;
    this.canvas = byId("view");
    this.renderer = new Renderer(this.canvas);
    this.camera = new Camera(stage.camera);
    this.legend = new Legend(byId("legend"), () => this.recolour());
    Object.assign(this, { frame: null, number: 0, hidden: 0, selected: -1, pulse: null, settings: {}, frames: new Map() });
    Object.assign(this, { colourBy: "intensity", sun: stage.sun ?? [0, 0, 1] });
    if (stage.arrays.faces) this.renderer.setSurface(stage.arrays, stage.opaque);
    byId("meshes").hidden = !stage.arrays.faces;
    byId("title").textContent = document.title = stage.title;
    byId("live").hidden = !this.isLive;
    this.#listen();
  }

  // A saved page has its frame in it and no one to render another.
  get isLive() {
    return this.stage.live && !byId("blob-stage");
  }

  #listen() {
    const redraw = () => this.redraw();
    for (const id of ["size", "opacity"]) byId(id).oninput = redraw;
    byId("field").onchange = event => {
      this.colourBy = event.target.value;
      this.colour(false);
    };
    steer(this.canvas, this.camera, {
      changed: redraw,
      clicked: (left, top) => this.select(this.pick(left, top)),
      doubled: (left, top) => {
        const point = this.pick(left, top);
        if (point >= 0) this.camera.turnAbout([...this.frame.arrays.xyz.subarray(3 * point, 3 * point + 3)]);
        this.redraw();
      },
    });
    new ResizeObserver(redraw).observe(this.canvas);
    addEventListener("keydown", event => {
      if (event.key.toLowerCase() === "r" && !["INPUT", "SELECT"].includes(event.target.tagName)) {
        this.camera.place(this.stage.camera.eye, this.stage.camera.target);
        this.redraw();
      }
    });
    byId("reset").onclick = () => {
      this.settings = {};
      this.choices();
      this.render(true);
    };
    const { frames } = this.stage;
    byId("frames").hidden = frames.length < 2;
    byId("frame").max = frames.length - 1;
    byId("frame").oninput = event => this.load(Number(event.target.value));
    byId("play").onclick = () => this.play();
  }

  choices() {
    showChoices(this.stage.choices ?? {}, this.settings, (key, value) => {
      // Numbers of one detector mean nothing to the other.
      const shared = Object.entries(this.settings).filter(([name]) => /^(sun|laser|optics)\./.test(name));
      this.settings = { ...Object.fromEntries(shared), [key]: value };
      this.render(true);
    });
  }

  async load(number) {
    this.number = number;
    byId("frame").value = number;
    byId("frame-name").textContent = `${number + 1} / ${this.stage.frames.length}  ${this.stage.frames[number]}`;
    if (!this.frames.has(number)) {
      // What was seen longest ago goes: frames are some 10 MB each.
      if (this.frames.size > 40) this.frames.delete(this.frames.keys().next().value);
      this.frames.set(number, await blob(`frame-${number}`));
    }
    if (this.number === number) this.show(this.frames.get(number), this.frame === null);
  }

  async play() {
    this.playing = !this.playing;
    byId("play").textContent = this.playing ? "⏸" : "▶";
    while (this.playing) {
      await Promise.all([this.load((this.number + 1) % this.stage.frames.length), new Promise(r => setTimeout(r, 100))]);
    }
  }

  // One request at a time; what was moved meanwhile goes with the next.
  async render(controls = false) {
    this.newControls ||= controls;
    this.waiting = true;
    if (this.busy) return;
    this.busy = true;
    while (this.waiting) {
      this.waiting = false;
      const since = performance.now();
      try {
        const frame = await blob("render", this.settings);
        byId("error").hidden = true;
        this.show(frame, this.newControls);
        this.newControls = false;
        this.milliseconds = performance.now() - since;
        byId("speed").textContent = `render ${(1e3 * frame.seconds).toFixed(0)} ms, `
          + `all ${this.milliseconds.toFixed(0)} ms`;
      } catch (error) {
        complain(error);
      }
    }
    this.busy = false;
  }

  show(frame, controls) {
    this.frame = frame;
    const { xyz, status } = frame.arrays;
    frame.values = name => frame.arrays[name] ?? xyz.filter((_, i) => i % 3 === "xyz".indexOf(name));
    const names = frame.fields.map(field => field.name);
    if (!names.includes(this.colourBy)) this.colourBy = "range";
    if (names.join() !== this.names) showFields(frame.fields, frame.groups, this.colourBy);
    this.names = names.join();
    const statuses = frame.fields.find(field => field.name === "status").names;
    const counts = Array(statuses.length).fill(0);
    for (const one of status) counts[one] += 1;
    showStatuses(statuses, counts, this.hidden, (bit, shown) => {
      this.hidden = shown ? this.hidden & ~(1 << bit) : this.hidden | 1 << bit;
      this.redraw();
    });
    const beams = frame.beams ? ` of ${frame.beams.toLocaleString("en")} pulses` : "";
    byId("counts").textContent = `${frame.count.toLocaleString("en")} points${beams}`;
    if (this.isLive && controls) {
      showControls(frame.controls, this.settings, (key, value) => {
        this.settings[key] = value;
        this.render();
      });
    }
    this.sun = frame.sun ?? this.sun;
    this.renderer.setPoints(xyz, status);
    this.colour(!controls);
    this.reselect();
  }

  colour(keep) {
    const field = this.frame.fields.find(one => one.name === this.colourBy);
    const values = this.frame.values(field.name);
    this.legend.show(field, values, keep);
    this.renderer.setValues(values);
    this.recolour();
  }

  recolour() {
    this.renderer.setMap(this.legend.map);
    this.redraw();
  }

  isShown(i) {
    return !(this.hidden >> this.frame.arrays.status[i] & 1) && this.legend.isShown(i);
  }

  pick(left, top) {
    return this.renderer.pick(this.matrix, this.frame.arrays.xyz, left, top, i => this.isShown(i));
  }

  select(index) {
    const { time, channel } = this.frame.arrays;
    this.pulse = index < 0 ? null : { time: time[index], channel: channel[index], azimuth: this.frame.arrays.azimuth[index] };
    this.selected = index;
    this.#card();
    this.redraw();
  }

  // The same pulse in another frame: its first point, if it has one.
  reselect() {
    if (!this.pulse) return;
    const { time, channel, azimuth } = this.frame.arrays;
    this.selected = time.findIndex((value, i) => value === this.pulse.time && channel[i] === this.pulse.channel
      && azimuth[i] === this.pulse.azimuth);
    this.#card();
    this.redraw();
  }

  #card() {
    byId("card").hidden = !this.pulse;
    if (!this.pulse) return;
    showCard(this.frame, this.selected, {
      origin: this.stage.origin, closed: () => this.select(-1), missing: "This pulse has no point in this frame.",
    });
  }

  redraw() {
    if (this.drawn) return;
    this.drawn = requestAnimationFrame(() => {
      this.drawn = 0;
      if (this.frame) this.draw();
    });
  }

  draw() {
    const { xyz } = this.frame.arrays;
    const sensor = minus(this.frame.sensor, this.stage.origin);
    const point = this.selected < 0 ? null : [...xyz.subarray(3 * this.selected, 3 * this.selected + 3)];
    this.matrix = this.renderer.draw(this.camera, {
      ...this.legend.style, size: Number(byId("size").value), opacity: Number(byId("opacity").value),
      sun: this.sun, hidden: this.hidden, alarms: this.colourBy !== "status", line: point && [...sensor, ...point],
    });
    this.#mark("ring", point);
    this.#mark("sensor", sensor);
  }

  #mark(id, point) {
    const place = point && this.renderer.project(this.matrix, ...point);
    byId(id).hidden = !place;
    if (place) Object.assign(byId(id).style, { left: `${place[0]}px`, top: `${place[1]}px` });
  }
}

function complain(error) {
  byId("error").textContent = error.message;
  byId("error").hidden = false;
}

let viewer = null;
(async () => {
  try {
    const opened = new Viewer(await blob("stage"));
    opened.choices();
    await opened.load(0);
    opened.draw();
    viewer = opened;
  } catch (error) {
    complain(error);
  }
})();
