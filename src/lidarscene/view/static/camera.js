// Camera: an eye that turns about a target, z up. Matrices are column-major, as WebGL has them.

const NEAR = 0.1, FAR = 5000;

const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
const plus = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];

class Camera {
  constructor({ eye, target, fov_deg }) {
    this.tangent = Math.tan(fov_deg * Math.PI / 360);
    this.place(eye, target);
  }

  place(eye, target) {
    const away = minus(eye, target);
    this.target = target;
    this.distance = Math.hypot(...away);
    this.azimuth = Math.atan2(away[1], away[0]);
    this.elevation = Math.asin(away[2] / this.distance);
  }

  get axes() {
    const level = Math.cos(this.elevation);
    const away = [level * Math.cos(this.azimuth), level * Math.sin(this.azimuth), Math.sin(this.elevation)];
    const right = [-Math.sin(this.azimuth), Math.cos(this.azimuth), 0];
    return { right, up: cross(away, right), away };
  }

  get eye() {
    return plus(this.target, scaled(this.axes.away, this.distance));
  }

  turn(right, up) {
    this.azimuth -= right;
    this.elevation = Math.max(-1.55, Math.min(1.55, this.elevation + up));
  }

  // By parts of the picture's width.
  shift(right, up) {
    const across = 2 * this.tangent * this.distance, axes = this.axes;
    this.target = plus(this.target, plus(scaled(axes.right, -right * across), scaled(axes.up, up * across)));
  }

  // From the sensor, a little ahead of it, so that the first turn is about what it sees.
  look(eye, ahead, distance = 8) {
    this.place(eye, plus(eye, scaled(ahead, distance)));
  }

  // From a direction, as far away that a box around these points fits.
  fit(xyz, from, aspect) {
    const axes = [[], [], []];
    const step = 3 * Math.max(1, Math.floor(xyz.length / 60000));
    for (let i = 0; i < xyz.length; i += step) for (let k = 0; k < 3; k++) axes[k].push(xyz[i + k]);
    if (!axes[0].length) return;
    for (const axis of axes) axis.sort((a, b) => a - b);
    // A few points far away decide nothing.
    const [low, high] = [0.02, 0.98].map(part => axes.map(axis => axis[Math.floor(part * (axis.length - 1))]));
    const middle = scaled(plus(low, high), 0.5), half = scaled(minus(high, low), 0.5);
    this.place(plus(middle, from), middle);
    const { right, up, away } = this.axes;
    const reach = axis => Math.abs(axis[0]) * half[0] + Math.abs(axis[1]) * half[1] + Math.abs(axis[2]) * half[2];
    this.distance = Math.min(2000, 1.05 * (Math.max(reach(right), aspect * reach(up)) / this.tangent) + reach(away));
  }

  zoom(factor) {
    this.distance = Math.max(0.2, Math.min(2000, this.distance * factor));
  }

  turnAbout(point) {
    this.place(this.eye, point);
  }

  // World to clip; `aspect` is width over height, the field of view is across.
  matrix(aspect) {
    const { right, up, away } = this.axes, eye = this.eye;
    const x = 1 / this.tangent, y = aspect / this.tangent;
    const depth = (FAR + NEAR) / (NEAR - FAR), shift = 2 * FAR * NEAR / (NEAR - FAR);
    const at = [-dot(right, eye), -dot(up, eye), -dot(away, eye)];
    const column = i => [x * right[i], y * up[i], depth * away[i], -away[i]];
    return new Float32Array([
      ...column(0), ...column(1), ...column(2), x * at[0], y * at[1], depth * at[2] + shift, -at[2],
    ]);
  }
}

// What moves the camera; `dragged` is called while it moves, `changed` when it stands, `clicked` with a place in pixels.
function steer(canvas, camera, { changed, dragged, rested, clicked, doubled }) {
  let moved = 0, before = null, rest = 0;
  const fingers = new Map();
  const pinch = () => {
    const [a, b] = [...fingers.values()];
    return { x: (a.clientX + b.clientX) / 2, y: (a.clientY + b.clientY) / 2, apart: Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY) };
  };
  canvas.addEventListener("contextmenu", event => event.preventDefault());
  canvas.addEventListener("pointerdown", event => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, event);
    // A second finger makes a pinch of it, and no click.
    [moved, before] = [fingers.size > 1 ? Infinity : 0, event];
  });
  canvas.addEventListener("pointermove", event => {
    clearTimeout(rest);
    if (!before) {
      // Where the pointer rests, not on its way: to find a point takes milliseconds.
      rest = setTimeout(() => rested(event.offsetX, event.offsetY), 60);
      return;
    }
    if (fingers.size === 2 && fingers.has(event.pointerId)) {
      const was = pinch();
      fingers.set(event.pointerId, event);
      const now = pinch();
      camera.zoom(was.apart / Math.max(now.apart, 1));
      camera.shift((now.x - was.x) / canvas.clientWidth, (now.y - was.y) / canvas.clientWidth);
      before = event;
      dragged();
      return;
    }
    fingers.set(event.pointerId, event);
    const dx = event.clientX - before.clientX, dy = event.clientY - before.clientY;
    moved += Math.hypot(dx, dy);
    const width = canvas.clientWidth;
    if (event.buttons & 6 || event.shiftKey) camera.shift(dx / width, dy / width);
    else camera.turn(dx * 0.005, dy * 0.005);
    before = event;
    dragged();
  });
  const end = event => {
    fingers.delete(event.pointerId);
    if (event.type === "pointerup" && before && moved < 4 && event.button === 0) {
      clicked(event.offsetX, event.offsetY, event.shiftKey);
    }
    before = fingers.size ? [...fingers.values()][0] : null;
    changed();
  };
  for (const type of ["pointerup", "pointercancel"]) canvas.addEventListener(type, end);
  canvas.addEventListener("dblclick", event => doubled(event.offsetX, event.offsetY));
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    camera.zoom(Math.exp(Math.sign(event.deltaY) * Math.min(Math.abs(event.deltaY), 120) * 0.001));
    changed();
  }, { passive: false });
}
