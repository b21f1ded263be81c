// Renderer: arrays in, a picture on a canvas out.

const SHADOW_PIXELS = 2048;

// Where most of the points are: the middle, and how far they reach.
function around(xyz) {
  const count = xyz.length / 3, sum = [0, 0, 0];
  if (!count) return { centre: sum, radius: 40 };
  for (let i = 0; i < xyz.length; i++) sum[i % 3] += xyz[i];
  const centre = sum.map(total => Math.round(total / count));
  let square = 0;
  for (let i = 0; i < xyz.length; i++) square += (xyz[i] - centre[i % 3]) ** 2;
  // Steps of ten metres: the shadows of one sweep do not shimmer in the next.
  return { centre, radius: Math.max(20, Math.min(120, 10 * Math.ceil(0.2 * Math.sqrt(square / count)))) };
}

class Renderer {
  constructor(canvas) {
    this.canvas = canvas;
    // A picture is saved from what was drawn last.
    this.gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    if (!this.gl) throw new Error("this browser has no WebGL 2, which the view needs");
    this.points = this.#program(POINT_SHADER);
    this.surface = this.#program(SURFACE_SHADER);
    this.line = this.#program(LINE_SHADER);
    [this.buffers, this.pointers, this.step, this.mostDragged] = [{}, {}, 1, 200000];
    this.arrays = Object.fromEntries(["points", "still", "surface", "caster", "line"].map(name => [name, this.gl.createVertexArray()]));
    this.map = this.gl.createTexture();
    this.counts = { points: 0, faces: 0, opaque: 0 };
    this.shadow = this.#shadowMap();
  }

  // Depths as the sun sees them; what compares itself with them knows whether it is lit.
  #shadowMap() {
    const gl = this.gl, texture = gl.createTexture(), frame = gl.createFramebuffer();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, SHADOW_PIXELS, SHADOW_PIXELS);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE);
    for (const key of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, key, gl.CLAMP_TO_EDGE);
    for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.LINEAR);
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, texture, 0);
    gl.drawBuffers([gl.NONE]);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return { texture, frame, matrix: new Float32Array(16), of: "" };
  }

  // Drawn anew when the sun, the surfaces or the points have moved.
  #castShadows(sun) {
    const gl = this.gl, { faces, opaque } = this.counts, { centre, radius } = this.around;
    const of = [sun, centre, radius, this.surfaces].join();
    if (!opaque || !faces || sun[2] <= 0 || this.shadow.of === of) return;
    this.shadow.of = of;
    const level = Math.hypot(sun[0], sun[1]);
    const x = level > 1e-3 ? [-sun[1] / level, sun[0] / level, 0] : [1, 0, 0], y = cross(sun, x);
    // What stands beside the points throws shadows on them too: deeper than wide.
    const deep = 3 * radius;
    const column = i => [x[i] / radius, y[i] / radius, -sun[i] / deep, 0];
    this.shadow.matrix = new Float32Array([...column(0), ...column(1), ...column(2),
      -dot(x, centre) / radius, -dot(y, centre) / radius, dot(sun, centre) / deep, 1]);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadow.frame);
    gl.viewport(0, 0, SHADOW_PIXELS, SHADOW_PIXELS);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.useProgram(this.line.program);
    gl.bindVertexArray(this.arrays.caster);
    gl.uniformMatrix4fv(this.line.uniforms.matrix, false, this.shadow.matrix);
    gl.drawElements(gl.TRIANGLES, opaque, gl.UNSIGNED_INT, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  #program([vertex, fragment]) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    const uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      uniforms[name] = gl.getUniformLocation(program, name);
    }
    return { program, uniforms };
  }

  // Data of an attribute of one of `arrays`; `size` numbers for each vertex.
  #attribute(array, shader, name, data, size, { type = this.gl.FLOAT, normalised = false } = {}) {
    const gl = this.gl, key = `${array}.${name}`;
    this.buffers[key] ??= gl.createBuffer();
    gl.bindVertexArray(this.arrays[array]);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[key]);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_DRAW);
    const place = gl.getAttribLocation(shader.program, name);
    gl.enableVertexAttribArray(place);
    const bytes = size * data.BYTES_PER_ELEMENT;
    this.pointers[key] = step => gl.vertexAttribPointer(place, size, type, normalised, step > 1 ? step * bytes : 0, 0);
    this.pointers[key](1);
  }

  // Every so many points of a layer from now on, drawn from its bound array.
  #thin(layer, step) {
    const gl = this.gl;
    for (const name of ["position", "status", "value"]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[`${layer}.${name}`]);
      this.pointers[`${layer}.${name}`](step);
    }
  }

  // `still` are the same points without the sensor's own motion, or nothing.
  setPoints(xyz, still, status) {
    this.counts.points = xyz.length / 3;
    this.around = around(xyz);
    this.layers = still ? { points: xyz, still } : { points: xyz };
    for (const [layer, places] of Object.entries(this.layers)) {
      this.#attribute(layer, this.points, "position", places, 3);
      this.#attribute(layer, this.points, "status", status, 1, { type: this.gl.UNSIGNED_BYTE });
    }
  }

  setValues(values) {
    // Infinity means that there is none; shaders need not know it.
    const plain = Float32Array.from(values, value => Number.isFinite(value) ? value : 3e38);
    for (const layer of Object.keys(this.layers)) this.#attribute(layer, this.points, "value", plain, 1);
  }

  setSurface({ vertices, colours, faces }, opaque) {
    const gl = this.gl;
    this.#attribute("surface", this.surface, "position", vertices, 3);
    this.#attribute("surface", this.surface, "tint", colours, 4, { type: gl.UNSIGNED_BYTE, normalised: true });
    this.buffers.faces ??= gl.createBuffer();
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.buffers.faces);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
    this.#attribute("caster", this.line, "position", vertices, 3);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.buffers.faces);
    this.surfaces = (this.surfaces ?? 0) + 1;
    Object.assign(this.counts, { faces: faces.length, opaque });
  }

  // 256 colours a row, (r, g, b, a) bytes.
  setMap(bytes) {
    const gl = this.gl;
    gl.bindTexture(gl.TEXTURE_2D, this.map);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, bytes.length / 1024, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.NEAREST);
  }

  draw(camera, style) {
    const gl = this.gl, ratio = Math.min(devicePixelRatio, 2);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map(n => Math.max(1, Math.round(n * ratio)));
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    gl.enable(gl.DEPTH_TEST);
    this.#castShadows(style.sun);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0.043, 0.055, 0.078, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const matrix = camera.matrix(width / height);
    this.#drawSurface(matrix, camera, style, false);
    this.#drawPoints(matrix, camera, style, ratio);
    this.#drawSurface(matrix, camera, style, true);
    if (style.line) this.#drawLine(matrix, style.line);
    return matrix;
  }

  #drawSurface(matrix, camera, { opacity, sun }, clear) {
    const gl = this.gl, { faces, opaque } = this.counts;
    const [first, count] = clear ? [opaque, faces - opaque] : [0, opaque];
    if (!count || opacity === 0) return;
    const { program, uniforms } = this.surface;
    gl.useProgram(program);
    gl.bindVertexArray(this.arrays.surface);
    gl.uniformMatrix4fv(uniforms.matrix, false, matrix);
    gl.uniform3fv(uniforms.eye, camera.eye);
    gl.uniform3fv(uniforms.sun, sun);
    gl.uniform1f(uniforms.opacity, opacity);
    gl.uniformMatrix4fv(uniforms.toSun, false, this.shadow.matrix);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.shadow.texture);
    gl.activeTexture(gl.TEXTURE0);
    gl.uniform1i(uniforms.shadow, 1);
    // Points lie on surfaces: these draw back a little.
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(2, 4);
    this.#blended(clear || opacity < 1, !clear, () => gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 4 * first));
    gl.disable(gl.POLYGON_OFFSET_FILL);
  }

  #blended(blend, depth, draw) {
    const gl = this.gl;
    if (blend) gl.enable(gl.BLEND);
    gl.depthMask(depth);
    draw();
    gl.depthMask(true);
    gl.disable(gl.BLEND);
  }

  #drawPoints(matrix, camera, style, ratio) {
    if (!this.counts.points) return;
    // A stride is at most 255 bytes, of which a position has 12.
    this.step = style.dragging ? Math.min(21, Math.ceil(this.counts.points / this.mostDragged)) : 1;
    const gl = this.gl, { program, uniforms } = this.points;
    gl.useProgram(program);
    gl.bindTexture(gl.TEXTURE_2D, this.map);
    gl.uniformMatrix4fv(uniforms.matrix, false, matrix);
    gl.uniform3fv(uniforms.eye, camera.eye);
    gl.uniform1f(uniforms.size, 3 * style.size * ratio);
    gl.uniform1f(uniforms.low, style.low);
    gl.uniform1f(uniforms.high, style.high);
    gl.uniform1i(uniforms.scale, style.scale);
    gl.uniform1ui(uniforms.hidden, style.hidden);
    gl.uniform1i(uniforms.alarms, style.alarms ? 1 : 0);
    for (const layer of style.layers.filter(name => name in this.layers)) {
      gl.bindVertexArray(this.arrays[layer]);
      this.#thin(layer, this.step);
      gl.drawArrays(gl.POINTS, 0, Math.ceil(this.counts.points / this.step));
    }
  }

  #drawLine(matrix, ends) {
    const gl = this.gl, { program, uniforms } = this.line;
    this.#attribute("line", this.line, "position", new Float32Array(ends), 3);
    gl.useProgram(program);
    gl.uniformMatrix4fv(uniforms.matrix, false, matrix);
    this.#blended(true, false, () => gl.drawArrays(gl.LINES, 0, 2));
  }

  // Place on the canvas in CSS pixels, and depth, of a point; null behind the eye.
  project(matrix, x, y, z) {
    const m = matrix, w = m[3] * x + m[7] * y + m[11] * z + m[15];
    if (w <= 0) return null;
    const u = (m[0] * x + m[4] * y + m[8] * z + m[12]) / w, v = (m[1] * x + m[5] * y + m[9] * z + m[13]) / w;
    return [(0.5 + 0.5 * u) * this.canvas.clientWidth, (0.5 - 0.5 * v) * this.canvas.clientHeight, w];
  }

  // The point nearest to this place among those in front, or -1.
  pick(matrix, xyz, left, top, isShown) {
    const near = [];
    let front = Infinity;
    for (let i = 0; 3 * i < xyz.length; i++) {
      const projected = this.project(matrix, xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]);
      if (!projected) continue;
      const away = Math.hypot(projected[0] - left, projected[1] - top);
      if (away > 7 || !isShown(i)) continue;
      near.push([i, away, projected[2]]);
      front = Math.min(front, projected[2]);
    }
    const candidates = near.filter(([, , depth]) => depth < 1.03 * front + 0.1);
    return candidates.reduce((best, candidate) => candidate[1] < best[1] ? candidate : best, [-1, Infinity])[0];
  }
}
