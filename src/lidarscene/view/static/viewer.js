// Viewer: the stage and its frames, put together. `viewer` is there for whoever opens the console.

class Viewer {
  constructor(stage) {
    this.stage = stage;
    this.canvas = byId("view");
    this.renderer = new Renderer(this.canvas);
    this.camera = new Camera(stage.camera);
    this.legend = new Legend(byId("legend"), () => this.recolour());
    Object.assign(this, { frame: null, number: 0, hidden: 0, selected: -1, other: -1, pulse: null, settings: {}, frames: new Map() });
    Object.assign(this, { colourBy: "intensity", sun: stage.sun ?? [0, 0, 1] });
    if (stage.arrays.faces) this.renderer.setSurface(stage.arrays, stage.opaque);
    byId("meshes").hidden = !stage.arrays.faces;
    byId("title").textContent = document.title = stage.title;
    byId("live").hidden = !this.isLive;
    if (this.isLive) byId("wait").textContent = "compiling and rendering; the first time takes some seconds";
    this.#listen();
  }

  // A saved page has its frame in it and no one to render another.
  get isLive() {
    return this.stage.live && !byId("blob-stage");
  }

  #listen() {
    const redraw = () => this.redraw();
    for (const id of ["size", "opacity", "raw", "still"]) byId(id).oninput = redraw;
    for (const place of ["first", "sensor", "top", "side", "fit"]) byId(`go-${place}`).onclick = () => this.go(place);
    byId("picture").onclick = () => this.savePicture();
    byId("copy").onclick = () => this.copyCommand();
    byId("field").onchange = event => {
      this.colourBy = event.target.value;
      if (this.frame.arrays[this.colourBy] || "xyz".includes(this.colourBy)) this.colour(false);
      else this.render();
    };
    steer(this.canvas, this.camera, {
      changed: () => {
        this.dragging = false;
        redraw();
      },
      dragged: () => {
        this.dragging = true;
        this.name(-1);
        redraw();
      },
      rested: (left, top) => this.name(this.pick(left, top), left, top),
      clicked: (left, top, second) => {
        if (second && this.selected >= 0) this.measure(this.pick(left, top));
        else this.select(this.pick(left, top));
      },
      doubled: (left, top) => {
        const point = this.pick(left, top);
        if (point >= 0) this.camera.turnAbout(this.#place(point));
        this.redraw();
      },
    });
    new ResizeObserver(redraw).observe(this.canvas);
    addEventListener("keydown", event => {
      if (["INPUT", "SELECT", "BUTTON"].includes(event.target.tagName) || event.ctrlKey || event.metaKey || event.altKey) return;
      const action = this.keys[event.key.toLowerCase()];
      if (!action) return;
      event.preventDefault();
      action();
    });
    byId("reset").onclick = () => {
      this.settings = {};
      byId("error").hidden = true;
      this.render(true);
    };
    const { frames } = this.stage;
    byId("frames").hidden = frames.length < 2;
    byId("frame").max = frames.length - 1;
    byId("frame").oninput = event => this.load(Number(event.target.value));
    byId("play").onclick = () => this.play();
  }

  // What the keys do.
  get keys() {
    const count = this.stage.frames.length;
    const step = by => () => count > 1 && this.load((this.number + by + count) % count);
    const grow = by => () => {
      byId("size").value = Number(byId("size").value) + by;
      this.redraw();
    };
    const swap = () => {
      if (byId("layers").hidden) return;
      const still = byId("raw").checked;
      [byId("raw").checked, byId("still").checked] = [!still, still];
      this.redraw();
    };
    const places = { r: "first", s: "sensor", t: "top", e: "side", f: "fit" };
    return {
      ...Object.fromEntries(Object.entries(places).map(([key, place]) => [key, () => this.go(place)])),
      " ": () => count > 1 && this.play(), arrowright: step(1), arrowleft: step(-1), d: swap,
      "+": grow(0.3), "-": grow(-0.3), escape: () => this.select(-1),
    };
  }

  // The camera at the sensor, above, beside, or where all points are seen.
  go(place) {
    const { xyz } = this.frame.arrays, aspect = this.canvas.clientWidth / this.canvas.clientHeight;
    const eye = minus(this.frame.sensor, this.stage.origin);
    if (place === "first") this.camera.place(this.stage.camera.eye, this.stage.camera.target);
    else if (place === "sensor") this.camera.look(eye, this.stage.ahead ?? this.#ahead(eye));
    else if (place === "top") this.camera.fit(xyz, [-0.02, 0, 1], aspect);
    else if (place === "side") this.camera.fit(xyz, [0, -1, 0.05], aspect);
    else this.camera.fit(xyz, this.camera.axes.away, aspect);
    this.redraw();
  }

  // Where a sensor looks that does not say: to the middle of its points, level.
  #ahead(eye) {
    const { xyz } = this.frame.arrays;
    let [x, y] = [0, 0];
    for (let i = 0; i < xyz.length; i += 3) [x, y] = [x + xyz[i] - eye[0], y + xyz[i + 1] - eye[1]];
    const length = Math.hypot(x, y);
    return length > 0 ? [x / length, y / length, 0] : [1, 0, 0];
  }

  savePicture() {
    this.draw();
    const name = `${document.title.replace(/[^\w.-]+/g, "-") || "lidarscene"}.png`;
    this.canvas.toBlob(image => {
      const link = createElement("a", { href: URL.createObjectURL(image), download: name });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    });
  }

  async copyCommand() {
    const command = this.frame.command ?? "";
    try {
      await navigator.clipboard.writeText(command);
      byId("copy").textContent = "copied";
    } catch {
      // Without the right to write there, it can be copied by hand.
      prompt("the command", command);
    }
    setTimeout(() => { byId("copy").textContent = "copy as command"; }, 1500);
  }

  choices() {
    showChoices(this.frame?.choices ?? this.stage.choices ?? {}, this.settings, (key, value) => {
      // Numbers of one detector mean nothing to the other, and those of one sensor to another.
      const shared = Object.entries(this.settings).filter(([name]) => key === "sensor"
        ? /^(sun|weather|run)\./.test(name) : /^(sun|weather|run|laser|optics)\.|^sensor$/.test(name));
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
      const word = setTimeout(() => { byId("speed").textContent = "compiling and rendering …"; }, 500);
      try {
        // A budget takes longer than the points: it is asked for where it is seen.
        const budget = this.pulse || this.ofBudget(this.colourBy) ? 1 : 0;
        const frame = await blob("render", { ...this.settings, "run.budget": budget });
        byId("error").hidden = true;
        clearNotes();
        await this.moveStage(this.settings["run.frame"]);
        this.show(frame, this.newControls);
        this.newControls = false;
        this.milliseconds = performance.now() - since;
        byId("speed").textContent = `render ${(1e3 * frame.seconds).toFixed(0)} ms, `
          + `all ${this.milliseconds.toFixed(0)} ms`;
      } catch (error) {
        if (!tellBeside(error.message)) complain(error);
      } finally {
        clearTimeout(word);
      }
    }
    this.busy = false;
  }

  // Surfaces, and the camera with them, as they are when another frame begins.
  async moveStage(number) {
    if (!this.stage.moves || this.stageNumber === number) return;
    const { arrays, camera, opaque } = await blob(number === undefined ? "stage" : `stage?frame=${number}`);
    if (arrays.faces) this.renderer.setSurface(arrays, opaque);
    this.camera.target = plus(this.camera.target, minus(camera.target, this.stage.camera.target));
    this.stage.camera = camera;
    this.stageNumber = number;
  }

  ofBudget(name) {
    return this.fields?.some(field => field.name === name && field.computed);
  }

  show(frame, controls) {
    this.frame = frame;
    if (frame.title) byId("title").textContent = document.title = frame.title;
    byId("wait").hidden = true;
    const { xyz, status } = frame.arrays;
    frame.values = name => frame.arrays[name] ?? xyz.filter((_, i) => i % 3 === "xyz".indexOf(name));
    const names = frame.fields.map(field => field.name);
    // Fields of a budget that was not asked for can be asked for.
    const computed = frame.budget === false ? (this.fields ?? []).filter(field => !names.includes(field.name)) : [];
    this.fields = [...frame.fields, ...computed.filter(field => field.computed)];
    const known = this.fields.map(field => field.name);
    if (!names.includes(this.colourBy)) this.colourBy = "range";
    if (known.join() !== this.names) showFields(this.fields, frame.groups, this.colourBy);
    this.names = known.join();
    byId("layers").hidden = !frame.arrays.still;
    byId("no-layers").hidden = !frame.layers;
    byId("no-layers").textContent = frame.layers ?? "";
    const statuses = frame.fields.find(field => field.name === "status").names;
    const counts = Array(statuses.length).fill(0);
    for (const value of status) counts[value] += 1;
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
      this.choices();
    }
    this.sun = frame.sun ?? this.sun;
    this.renderer.setPoints(xyz, frame.arrays.still, status);
    this.colour(!controls);
    this.reselect();
  }

  colour(keep) {
    const field = this.frame.fields.find(field => field.name === this.colourBy);
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
    return this.renderer.pick(this.matrix, this.places, left, top, i => this.isShown(i));
  }

  select(index) {
    const { time, channel } = this.frame.arrays;
    this.pulse = index < 0 ? null : { time: time[index], channel: channel[index], azimuth: this.frame.arrays.azimuth[index] };
    this.selected = index;
    this.other = -1;
    if (index >= 0 && this.isLive && this.frame.budget === false) this.render();
    this.#card();
    this.redraw();
  }

  // The body of a point beside the pointer; -1 for none.
  name(index, left = 0, top = 0) {
    const body = this.frame?.fields.find(field => field.name === "body" && field.names);
    const name = index < 0 || !body ? undefined : body.names[this.frame.values("body")[index]];
    byId("hover").hidden = name === undefined;
    if (name === undefined) return;
    byId("hover").textContent = name;
    Object.assign(byId("hover").style, { left: `${left + 14}px`, top: `${top + 10}px` });
  }

  // Another point, whose distance from the selected one is shown.
  measure(index) {
    this.other = index;
    this.#card();
    this.redraw();
  }

  // What is clicked: the points as they were seen, or deskewed if these alone are shown.
  get places() {
    const { xyz, still } = this.frame.arrays;
    return still && byId("still").checked && !byId("raw").checked ? still : xyz;
  }

  #place(index) {
    return [...this.places.subarray(3 * index, 3 * index + 3)];
  }

  // The same pulse in another frame: its first point, if it has one.
  reselect() {
    if (!this.pulse) return;
    const { time, channel, azimuth } = this.frame.arrays;
    this.other = -1;
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
    if (this.other >= 0 && this.selected >= 0) {
      const apart = minus(this.#place(this.other), this.#place(this.selected));
      const parts = apart.map((d, k) => `${"xyz"[k]} ${d.toFixed(3)}`).join(", ");
      const text = `${Math.hypot(...apart).toFixed(3)}\u202fm to the other point: ${parts}`;
      byId("card").insertBefore(createElement("p", { id: "distance" }, text), byId("card").children[1]);
    }
  }

  redraw() {
    if (this.drawn) return;
    this.drawn = requestAnimationFrame(() => {
      this.drawn = 0;
      if (this.frame) this.draw();
    });
  }

  draw() {
    const sensor = minus(this.frame.sensor, this.stage.origin);
    const point = this.selected < 0 ? null : this.#place(this.selected);
    const second = this.other < 0 ? null : this.#place(this.other);
    const layers = [["raw", "points"], ["still", "still"]].filter(([id]) => byId(id).checked).map(([, name]) => name);
    this.matrix = this.renderer.draw(this.camera, {
      ...this.legend.style, size: Number(byId("size").value), opacity: Number(byId("opacity").value),
      sun: this.sun, hidden: this.hidden, alarms: this.colourBy !== "status", line: point && [...(second ?? sensor), ...point],
      layers: this.frame.arrays.still ? layers : ["points"], dragging: this.dragging,
    });
    this.#mark("ring", point);
    this.#mark("second", second);
    this.#mark("sensor", sensor);
  }

  #mark(id, point) {
    const place = point && this.renderer.project(this.matrix, ...point);
    byId(id).hidden = !place;
    if (place) Object.assign(byId(id).style, { left: `${place[0]}px`, top: `${place[1]}px` });
  }
}

function complain(error) {
  byId("wait").hidden = true;
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
