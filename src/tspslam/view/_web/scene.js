// A surface with what it is coloured by, and a camera's path, to turn: WebGL 2, no library, no request.
// Each element of class "space" holds its scene as JSON, packed by _space.py, and its switches, made by _turning.py.
"use strict";
(() => {
  const FIELD = 0.7; // rad, from the top of the picture to its bottom
  const TURN = 0.007, STEP = Math.PI / 36; // rad a px dragged, rad a key pressed
  const STEEPEST = Math.PI / 2 - 1e-3;
  const TRIMMED = 0.005; // of the vertices at each end of each direction do not decide the first view
  const SAMPLED = 6000; // vertices that decide it
  const NEAR = 14; // px: a click hits an edge or a point this near
  const LAP = 15; // s: the path is played in this time
  const ASK = "Click on the picture: what is there is said here.";
  const STATES = ["keyframe", "tracked", "weak", "lost", "loop"];
  const PATH = [232, 89, 12, 255], WEAK = [160, 90, 210, 255], LOST = [140, 146, 154, 255], LOOP = [20, 150, 200, 255];
  const OTHERS = [[0, 145, 105, 255], [200, 90, 150, 255], [70, 150, 220, 255]]; // told apart by the colour-blind
  const NOW = [40, 110, 240, 255], PLAIN = [70, 125, 205, 150], TAIL = [25, 60, 150, 255], HEAD = [255, 205, 40, 255];
  const PICKED = [255, 0, 140, 255];
  const KINDS = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, i2: Int16Array, i4: Int32Array, f4: Float32Array };

  const FACES = [
    `#version 300 es
    uniform mat4 view; in vec3 place; in vec4 tint; out vec3 at; out vec4 colour;
    void main() { at = place; colour = tint; gl_Position = view * vec4(place, 1.0); }`,
    `#version 300 es
    precision highp float;
    uniform vec3 light; uniform bool isClear; in vec3 at; in vec4 colour; out vec4 seen;
    void main() {
      if (colour.a < 0.02 || (colour.a < 0.99) != isClear) discard;
      vec3 across = cross(dFdx(at), dFdy(at));
      float shade = 0.84 + 0.2 * abs(dot(across, light)) / max(length(across), 1e-20);
      seen = vec4(min(colour.rgb * shade, 1.0), colour.a);
    }`,
  ];
  const LINES = [
    `#version 300 es
    uniform mat4 view; uniform vec2 size; uniform float width, lift; uniform vec4 cover;
    in vec3 start, end; in vec4 startTint, endTint; in vec2 along; out vec4 colour; out float way;
    void main() {
      vec4 p = view * vec4(start, 1.0), q = view * vec4(end, 1.0);
      bool isEnd = (gl_VertexID & 1) == 1;
      colour = isEnd ? endTint : startTint;
      way = isEnd ? along.y : along.x;
      float a = p.z + p.w, b = q.z + q.w; // behind the nearest plane: cut off there
      if ((a <= 0.0 && b <= 0.0) || colour.a < 0.02) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
      vec4 from = a < 0.0 ? mix(p, q, a / (a - b)) : p, to = b < 0.0 ? mix(p, q, a / (a - b)) : q;
      if (cover.a > 0.0) colour = cover;
      vec2 ahead = (to.xy / to.w - from.xy / from.w) * size;
      ahead = length(ahead) > 1e-6 ? normalize(ahead) : vec2(1.0, 0.0);
      float side = gl_VertexID > 1 ? 0.5 : -0.5;
      vec4 here = isEnd ? to : from;
      vec2 shift = vec2(-ahead.y, ahead.x) * side * width + ahead * (isEnd ? 0.25 : -0.25) * width;
      here.xy += 2.0 * shift / size * here.w;
      here.z -= lift * here.w;
      gl_Position = here;
    }`,
    `#version 300 es
    precision highp float;
    uniform float dash; in vec4 colour; in float way; out vec4 seen;
    void main() { if (dash > 0.0 && fract(way / dash) > 0.6) discard; seen = colour; }`,
  ];
  const POINTS = [
    `#version 300 es
    uniform mat4 view; uniform float width, lift; in vec3 place; in vec4 tint; out vec4 colour;
    void main() {
      colour = tint; gl_Position = view * vec4(place, 1.0); gl_Position.z -= lift * gl_Position.w; gl_PointSize = width;
      if (tint.a < 0.02) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    }`,
    `#version 300 es
    precision highp float;
    in vec4 colour; out vec4 seen;
    void main() { if (length(gl_PointCoord - 0.5) > 0.5) discard; seen = colour; }`,
  ];

  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const plus = (a, b, k = 1) => [a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => { const size = Math.hypot(...a) || 1; return a.map((x) => x / size); };
  const at = (places, row) => [places[3 * row], places[3 * row + 1], places[3 * row + 2]];
  const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
  const rgb = (colour) => `rgb(${colour.slice(0, 3).join(",")})`;

  function element(tag, words = "", name = "") {
    const made = document.createElement(tag);
    if (words) made.textContent = words;
    if (name) made.className = name;
    return made;
  }

  // ---- what is packed ----

  class Packed {
    constructor(text) {
      const { data, ...meta } = JSON.parse(text);
      const binary = atob(data);
      this.bytes = new Uint8Array(binary.length);
      for (let k = 0; k < binary.length; k++) this.bytes[k] = binary.charCodeAt(k);
      this.meta = meta;
    }

    array([kind, start, count]) { return new KINDS[kind](this.bytes.buffer, start, count); }

    mask(entry, count) { // 1 where set; no entry: everywhere
      const set = new Uint8Array(count).fill(1);
      if (entry) {
        const bits = this.array(entry);
        for (let k = 0; k < count; k++) set[k] = (bits[k >> 3] >> (k & 7)) & 1;
      }
      return set;
    }

    rows(entry, count) { // numbers in the whole of what is left of it
      const rows = new Uint32Array(count), set = entry ? this.mask(entry, 8 * entry[2]) : null;
      for (let k = 0, row = 0; k < count; k++, row++) {
        while (set && !set[row]) row++;
        rows[k] = row;
      }
      return rows;
    }
  }

  // ---- what the graphics card holds ----

  function program(gl, [vertex, fragment], names) {
    const made = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    names.forEach((name, k) => gl.bindAttribLocation(made, k, name));
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(made));
    const uniforms = {};
    for (let k = 0; k < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); k++) {
      const { name } = gl.getActiveUniform(made, k);
      uniforms[name] = gl.getUniformLocation(made, name);
    }
    return { program: made, uniforms };
  }

  class Batch { // arrays of vertices, or of instances, one after another in each attribute
    constructor(gl, arrays, divisor) {
      Object.assign(this, { gl, divisor, vao: gl.createVertexArray(), buffers: [] });
      this.set(arrays);
    }

    set(arrays) { // each [values, numbers an element, numbers to skip at its start, of how many in all]
      const { gl } = this;
      gl.bindVertexArray(this.vao);
      arrays.forEach((entry, place) => {
        if (!entry) return;
        const [values, size, first = 0, all = size] = entry;
        this.buffers[place] ??= gl.createBuffer();
        gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[place]);
        gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
        const isByte = values instanceof Uint8Array, kind = isByte ? gl.UNSIGNED_BYTE : gl.FLOAT;
        gl.enableVertexAttribArray(place);
        gl.vertexAttribPointer(place, size, kind, isByte, all * values.BYTES_PER_ELEMENT, first * values.BYTES_PER_ELEMENT);
        gl.vertexAttribDivisor(place, this.divisor);
        this.count = values.length / all;
      });
      gl.bindVertexArray(null);
    }
  }

  const lineArrays = (ends, colours, along) => [
    ends && [ends, 3, 0, 6], ends && [ends, 3, 3, 6], colours && [colours, 4, 0, 8], colours && [colours, 4, 4, 8],
    along && [along, 2],
  ];

  // Lines as plain arrays, then as typed ones.
  class Pen {
    constructor() { this.ends = []; this.colours = []; this.along = []; }

    line(a, b, colour, end = colour, from = 0, to = 0) {
      this.ends.push(...a, ...b);
      this.colours.push(...colour, ...end);
      this.along.push(from, to);
    }

    arrays() {
      return lineArrays(new Float32Array(this.ends), new Uint8Array(this.colours), new Float32Array(this.along));
    }
  }

  // ---- one scene ----

  class Scene {
    constructor(root) {
      this.root = root;
      this.form = root.querySelector("form");
      this.canvas = root.querySelector("canvas");
      const options = { antialias: true, preserveDrawingBuffer: true, alpha: false };
      this.gl = this.canvas.getContext("webgl2", options);
      root.querySelector(".idle").hidden = true;
      if (!this.gl) {
        root.querySelector(".without").hidden = false;
        return;
      }
      this.form.hidden = false;
      this.thumb = element("img", "", "thumb");
      this.thumb.hidden = true;
      this.canvas.after(this.thumb);
      this.read(new Packed(root.querySelector('script[type="application/json"]').textContent));
      this.now = 0;
      this.layer = this.layers[Number(new FormData(this.form).get("layer"))] ?? null;
      this.shaped();
      this.load();
      this.listen();
      this.look("first");
      this.chosen();
      this.stand(0);
    }

    read(packed) {
      const { meta } = packed, array = (entry) => packed.array(entry);
      this.meta = meta;
      const steps = array(meta.places), n = steps.length / 3;
      this.corners = array(meta.faces);
      this.ends = array(meta.edges);
      this.count = { vertex: n, edge: this.ends.length / 2, face: this.corners.length / 3 };
      this.middle = meta.quantum.map((x) => x * 32767.5); // of what is shown, from `low`: the origin here
      this.origin = plus(meta.low, this.middle);
      this.places = new Float32Array(3 * n);
      for (let k = 0; k < 3 * n; k++) this.places[k] = steps[k] * meta.quantum[k % 3] - this.middle[k % 3];
      this.rows = {};
      for (const level of ["vertex", "edge", "face"]) this.rows[level] = packed.rows(meta.rows[level], this.count[level]);
      this.tables = Object.fromEntries(Object.entries(meta.tables).map(([name, entry]) => [name, array(entry)]));
      this.layers = meta.layers.map((layer) => (
        { ...layer, steps: array(layer.steps), ok: packed.mask(layer.ok, this.count[layer.level]) }
      ));
      this.isBelow = packed.mask(meta.ceiling, this.count.face);
      this.isLow = new Uint8Array(n).fill(meta.ceiling ? 0 : 1); // a vertex of a face that is no ceiling, or of none
      if (meta.ceiling) {
        const has = new Uint8Array(n);
        this.corners.forEach((v, k) => { has[v] = 1; if (this.isBelow[Math.floor(k / 3)]) this.isLow[v] = 1; });
        has.forEach((x, v) => { if (!x) this.isLow[v] = 1; });
      }
      this.readPath(packed);
    }

    readPath(packed) {
      const local = (entry) => packed.array(entry).map((x, k) => x - this.origin[k % 3]);
      const { numbers, states, places, axes } = this.meta.stations;
      this.numbers = packed.array(numbers);
      this.states = packed.array(states);
      this.stations = local(places);
      this.turns = packed.array(axes).map((x) => x); // right and down, 32767 to one
      this.others = this.meta.others.map(({ words, places: entry }) => ({ words, places: local(entry) }));
    }

    isKnown(row) { return Number.isFinite(this.stations[3 * row]); }

    // Right, down and forward of a station's camera.
    cameraAxes(row) {
      const part = (k) => unit([0, 1, 2].map((c) => this.turns[6 * row + 3 * k + c]));
      return [part(0), part(1), cross(part(0), part(1))];
    }

    // How large the whole is, the cameras are drawn, strokes are long.
    shaped() {
      const up = unit(this.meta.up), ahead = unit(this.meta.ahead);
      this.basis = [cross(ahead, up), up, ahead]; // right, up, ahead
      const points = [], every = Math.ceil(this.count.vertex / SAMPLED);
      for (let v = 0; v < this.count.vertex; v += every) points.push(at(this.places, v));
      this.sample = points;
      this.way = this.numbers.length > 1 ? [...this.numbers.keys()].filter((k) => this.isKnown(k)) : [];
      const spans = [0, 1, 2].map((k) => {
        const [low, high] = this.range(points.map((p) => p[k]));
        return high - low;
      });
      this.radius = Math.max(Math.hypot(...spans) / 2, 1e-6);
      const keys = [...this.numbers.keys()].filter((k) => this.isKnown(k) && STATES[this.states[k]] !== "tracked");
      const gaps = keys.slice(1).map((k, j) => Math.hypot(...plus(at(this.stations, k), at(this.stations, keys[j]), -1)));
      gaps.sort((a, b) => a - b);
      const gap = gaps[gaps.length >> 1] || this.radius;
      this.small = clamp(0.45 * gap, 0.008 * this.radius, 0.035 * this.radius);
      this.large = Math.max(2.2 * this.small, 0.045 * this.radius);
      if (this.numbers.length === 1 && this.isKnown(0)) { // smaller than what is before a single camera
        this.large = clamp(0.5 * this.depths(0, 0.05), 0.003 * this.radius, 0.045 * this.radius);
      }
    }

    range(values) { // all but a few at each end
      const sorted = Float64Array.from(values).sort(), cut = Math.floor(TRIMMED * sorted.length);
      return [sorted[cut], sorted[sorted.length - 1 - cut]];
    }

    // ---- what is drawn ----

    load() { // also after a lost context
      const { gl } = this;
      this.programs = {
        faces: program(gl, FACES, ["place", "tint"]),
        lines: program(gl, LINES, ["start", "end", "startTint", "endTint", "along"]),
        points: program(gl, POINTS, ["place", "tint"]),
      };
      const spread = new Float32Array(3 * this.corners.length);
      this.corners.forEach((v, k) => spread.set(this.places.subarray(3 * v, 3 * v + 3), 3 * k));
      const lines = new Float32Array(3 * this.ends.length);
      this.ends.forEach((v, k) => lines.set(this.places.subarray(3 * v, 3 * v + 3), 3 * k));
      this.faces = new Batch(gl, [[spread, 3]], 0);
      this.edges = new Batch(gl, lineArrays(lines, null, new Float32Array(this.ends.length)), 1);
      this.points = new Batch(gl, [[this.places, 3]], 0);
      const loops = [...this.states.keys()].filter((k) => STATES[this.states[k]] === "loop" && this.isKnown(k));
      const dots = new Float32Array(loops.flatMap((k) => at(this.stations, k)));
      this.loops = new Batch(gl, [[dots, 3], [new Uint8Array(loops.flatMap(() => LOOP)), 4]], 0);
      this.path = this.drawn((pen) => this.pathLines(pen));
      this.beside = this.drawn((pen) => this.others.forEach((x, k) => this.otherLines(pen, x.places, OTHERS[k % 3])));
      this.strokes = this.drawn((pen) => this.strokeLines(pen));
      this.frustums = this.drawn((pen) => this.numbers.forEach((_, k) => {
        if (this.numbers.length > 1 && ["keyframe", "loop"].includes(STATES[this.states[k]])) this.frustum(pen, k, this.small, PATH);
      }));
      this.camera = new Batch(gl, new Pen().arrays(), 1);
      this.marks = new Batch(gl, new Pen().arrays(), 1);
      this.mark = new Batch(gl, [[new Float32Array(0), 3], [new Uint8Array(0), 4]], 0);
      this.paint();
    }

    drawn(draw) {
      const pen = new Pen();
      draw(pen);
      return new Batch(this.gl, pen.arrays(), 1);
    }

    pathLines(pen) {
      for (let k = 1; k < this.numbers.length; k++) {
        if (!this.isKnown(k - 1) || !this.isKnown(k)) continue;
        const state = STATES[this.states[k]];
        pen.line(at(this.stations, k - 1), at(this.stations, k), state === "lost" ? LOST : state === "weak" ? WEAK : PATH);
      }
    }

    otherLines(pen, places, colour) {
      let way = 0;
      for (let k = 1; k < places.length / 3; k++) {
        const a = at(places, k - 1), b = at(places, k), length = Math.hypot(...plus(b, a, -1));
        if (!Number.isFinite(length)) continue;
        pen.line(a, b, colour, colour, way, way + length);
        way += length;
      }
    }

    strokeLines(pen) { // along the response's direction, from dark to bright
      const layer = this.layers.find((x) => x.name === "direction");
      if (!layer) return;
      const lengths = [], every = Math.ceil(this.count.edge / SAMPLED);
      for (let k = 0; k < this.count.edge; k += every) {
        lengths.push(Math.hypot(...plus(at(this.places, this.ends[2 * k]), at(this.places, this.ends[2 * k + 1]), -1)));
      }
      lengths.sort((a, b) => a - b);
      const length = 0.7 * (lengths[lengths.length >> 1] || 0.01 * this.radius);
      for (let v = 0; v < this.count.vertex; v++) {
        if (layer.ok[v] && this.isLow[v]) {
          const a = at(this.places, v);
          pen.line(a, plus(a, unit(this.direction(layer, v)), length), TAIL, HEAD);
        }
      }
    }

    direction(layer, row) { // of the colours: red right, green up, blue forward
      const [r, g, b] = at(layer.steps, row).map((x) => x / 127.5 - 1);
      return [r, -g, b];
    }

    frustum(pen, row, size, colour) {
      if (!this.isKnown(row)) return;
      const eye = at(this.stations, row), [right, down, forward] = this.cameraAxes(row);
      const [left, top, rightmost, bottom] = this.meta.camera;
      const far = Math.max(rightmost - left, bottom - top, 1); // wide angles stay small
      const corner = (x, y) => plus(plus(plus(eye, right, x * size / far), down, y * size / far), forward, size / far);
      const image = [corner(left, top), corner(rightmost, top), corner(rightmost, bottom), corner(left, bottom)];
      image.forEach((c, k) => { pen.line(eye, c, colour); pen.line(c, image[(k + 1) % 4], colour); });
      const peak = plus(corner((left + rightmost) / 2, top), down, 0.3 * size * (top - bottom) / far);
      pen.line(image[0], peak, colour);
      pen.line(peak, image[1], colour);
    }

    colour(layer, row, into, k) { // of an element; a step for plain values, three for colours
      if (!layer || !layer.ok[row]) {
        into.set(this.meta.bare, k);
        into[k + 3] = 102;
        return;
      }
      if (layer.scale === "rgb") into.set(layer.steps.subarray(3 * row, 3 * row + 3), k);
      else into.set(this.tables[layer.scale].subarray(3 * layer.steps[row], 3 * layer.steps[row] + 3), k);
      into[k + 3] = 255;
    }

    paint() { // colours of all elements by the layer
      const { layer } = this, level = layer ? layer.level : "none", hides = !this.on("ceiling");
      const tints = new Uint8Array(4 * this.corners.length), pale = this.isDark ? [58, 72, 90] : [168, 184, 204];
      for (let f = 0; f < this.count.face; f++) {
        const corners = this.corners.subarray(3 * f, 3 * f + 3);
        for (let c = 0; c < 3; c++) {
          const k = 12 * f + 4 * c;
          if (hides && !this.isBelow[f]) tints[k + 3] = 0;
          else if (level === "edge") tints.set([...pale, 255], k);
          else if (level === "vertex" && corners.every((v) => layer.ok[v])) this.colour(layer, corners[c], tints, k);
          else this.colour(level === "face" ? layer : null, f, tints, k);
        }
      }
      this.faces.set([null, [tints, 4]]);
      const lines = new Uint8Array(4 * this.ends.length);
      for (let e = 0; e < this.count.edge; e++) {
        for (let k = 8 * e; k < 8 * e + 8; k += 4) {
          if (hides && !(this.isLow[this.ends[2 * e]] && this.isLow[this.ends[2 * e + 1]])) lines[k + 3] = 0;
          else if (level === "edge") this.colour(layer, e, lines, k);
          else lines.set(PLAIN, k);
        }
      }
      this.edges.set(lineArrays(null, lines, null));
      const dots = new Uint8Array(4 * this.count.vertex);
      for (let v = 0; v < this.count.vertex; v++) {
        if (hides && !this.isLow[v]) dots[4 * v + 3] = 0;
        else if (level === "vertex") this.colour(layer, v, dots, 4 * v);
        else dots.set([...PLAIN.slice(0, 3), 255], 4 * v);
      }
      this.points.set([null, [dots, 4]]);
    }

    on(name) { return Boolean(this.form.elements[name]?.checked); }

    request() { this.asked ??= requestAnimationFrame(() => { this.asked = null; this.draw(); }); }

    resize() {
      const ratio = Math.min(devicePixelRatio || 1, 2), { canvas } = this;
      const width = Math.max(1, Math.round(canvas.clientWidth * ratio));
      const height = Math.max(1, Math.round(canvas.clientHeight * ratio));
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
      this.ratio = ratio * clamp(canvas.clientWidth / 900, 0.65, 1); // of widths: lines are thinner in a small picture
    }

    draw() {
      const { gl, canvas } = this;
      if (gl.isContextLost() || !canvas.clientWidth) return;
      this.resize();
      const paper = this.isPrinted ? [255, 255, 255]
        : (getComputedStyle(canvas.parentElement).backgroundColor.match(/\d+/g) || [255, 255, 255]).slice(0, 3).map(Number);
      this.paper = [...paper, 255];
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.clearColor(...paper.map((x) => x / 255), 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.enable(gl.DEPTH_TEST);
      gl.depthFunc(gl.LEQUAL);
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
      this.view = this.matrix();
      if (this.on("surface")) this.drawFaces(false);
      if (this.on("edges")) this.drawLines(this.edges, this.layer?.level === "edge" ? 1.6 : 1, 2e-5);
      if (this.on("strokes")) this.drawLines(this.strokes, 2, 1e-4);
      if (this.on("points")) this.drawPoints(this.points, 4.5, 5e-5);
      if (this.on("surface")) this.drawFaces(true);
      if (this.on("path")) {
        this.drawLines(this.beside, 2.5, 2e-4, { dash: 0.02 * this.radius });
        this.drawLines(this.path, 3.5, 2e-4, { halo: true });
        this.drawPoints(this.loops, 11, 3e-4);
      }
      if (this.on("frustums")) {
        this.drawLines(this.frustums, 1.3, 1e-4);
        this.drawLines(this.camera, 2.6, 3e-4, { halo: true });
      }
      this.drawLines(this.marks, 3, 1e-3, { halo: true });
      this.drawPoints(this.mark, 12, 1e-3);
      this.measure();
      canvas.dataset.draws = Number(canvas.dataset.draws || 0) + 1;
      canvas.dataset.drawn ??= Math.round(performance.now()); // ms from the page's start to the first picture
    }

    start(kind) {
      const { gl } = this, { program: made, uniforms } = this.programs[kind];
      gl.useProgram(made);
      gl.uniformMatrix4fv(uniforms.view, false, this.view);
      return uniforms;
    }

    drawFaces(isClear) {
      const { gl } = this, uniforms = this.start("faces"), [right, up, ahead] = this.basis;
      gl.uniform3fv(uniforms.light, unit(plus(plus(right.map((x) => -0.35 * x), up, 0.48), ahead, -0.79)));
      gl.uniform1i(uniforms.isClear, isClear);
      gl.enable(gl.POLYGON_OFFSET_FILL);
      gl.polygonOffset(1, 1);
      gl.depthMask(!isClear);
      gl.bindVertexArray(this.faces.vao);
      gl.drawArrays(gl.TRIANGLES, 0, this.faces.count);
      gl.depthMask(true);
      gl.disable(gl.POLYGON_OFFSET_FILL);
    }

    drawLines(batch, width, lift, { dash = 0, halo = false } = {}) {
      if (!batch.count) return;
      const { gl, canvas } = this, uniforms = this.start("lines");
      gl.uniform2f(uniforms.size, canvas.width, canvas.height);
      gl.uniform1f(uniforms.dash, dash);
      gl.bindVertexArray(batch.vao);
      for (const extra of halo ? [2.5, 0] : [0]) {
        gl.uniform4fv(uniforms.cover, extra ? this.paper.map((x) => x / 255) : [0, 0, 0, 0]);
        gl.uniform1f(uniforms.width, (width + extra) * this.ratio);
        gl.uniform1f(uniforms.lift, extra ? lift : 2 * lift);
        gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, batch.count);
      }
    }

    drawPoints(batch, width, lift) {
      if (!batch.count) return;
      const { gl } = this, uniforms = this.start("points");
      gl.uniform1f(uniforms.width, width * this.ratio);
      gl.uniform1f(uniforms.lift, lift);
      gl.bindVertexArray(batch.vao);
      gl.drawArrays(gl.POINTS, 0, batch.count);
    }

    // ---- from where it is seen ----

    axes() { // right and up of the picture, and from it to the viewer
      const [right, up, ahead] = this.basis, { yaw, pitch } = this;
      const level = plus(right.map((x) => x * Math.sin(yaw)), ahead, -Math.cos(yaw));
      const back = plus(level.map((x) => x * Math.cos(pitch)), up, Math.sin(pitch));
      const across = unit(cross(up, level));
      return [across, cross(back, across), back];
    }

    eye() { return plus(this.target, this.axes()[2], this.distance); }

    matrix() {
      const [x, y, z] = this.axes(), eye = this.eye(), { width, height } = this.canvas;
      const f = 1 / Math.tan(FIELD / 2), reach = this.distance + Math.hypot(...this.target) + 6 * this.radius;
      const near = Math.max(Math.min(this.distance * 0.02, this.radius * 0.02), reach * 2e-5), far = reach;
      const a = f * height / width, c = (far + near) / (near - far), d = 2 * far * near / (near - far);
      const t = [-dot(x, eye), -dot(y, eye), -dot(z, eye)];
      return new Float32Array([
        a * x[0], f * y[0], c * z[0], -z[0], a * x[1], f * y[1], c * z[1], -z[1],
        a * x[2], f * y[2], c * z[2], -z[2], a * t[0], f * t[1], c * t[2] + d, -t[2],
      ]);
    }

    // Choose target and distance so that nearly all is in the picture, whatever its shape.
    fit() {
      const [x, y, z] = this.axes(), inside = (p) => [dot(p, x), dot(p, y), dot(p, z)];
      let seen = this.sample.map(inside);
      const ranges = [0, 1, 2].map((k) => this.range(seen.map((p) => p[k])));
      seen = seen.filter((p) => ranges.every(([low, high], k) => p[k] >= low && p[k] <= high));
      seen.push(...this.way.map((k) => inside(at(this.stations, k))));
      if (!seen.length) seen = this.sample.map(inside);
      const high = Math.tan(FIELD / 2) * 0.92, wide = high * this.canvas.clientWidth / Math.max(this.canvas.clientHeight, 1);
      const span = (k) => [Math.min(...seen.map((p) => p[k])), Math.max(...seen.map((p) => p[k]))];
      const centre = [0, 1, 2].map((k) => (span(k)[0] + span(k)[1]) / 2);
      let distance = this.radius;
      for (let round = 0; round < 4; round++) {
        distance = Math.max(...seen.map((p) => (
          p[2] - centre[2] + Math.max(Math.abs(p[0] - centre[0]) / wide, Math.abs(p[1] - centre[1]) / high)
        )), 1e-6);
        for (const k of [0, 1]) {
          const places = seen.map((p) => (p[k] - centre[k]) / Math.max(distance - p[2] + centre[2], 1e-9));
          centre[k] += distance * (Math.min(...places) + Math.max(...places)) / 2;
        }
      }
      this.target = plus(plus(x.map((v) => v * centre[0]), y, centre[1]), z, centre[2]);
      this.distance = distance;
    }

    look(name) {
      if (name === "path" && this.numbers.length && this.isKnown(this.now)) this.lookAlong();
      else if (name === "above") {
        this.pitch = STEEPEST;
        const tried = [0, Math.PI / 2].map((yaw) => { this.yaw = yaw; this.fit(); return this.distance; });
        this.yaw = tried[0] <= tried[1] ? 0 : Math.PI / 2;
        this.fit();
      } else {
        const [right, up, ahead] = this.meta.eye;
        this.yaw = Math.atan2(right, -ahead);
        this.pitch = Math.atan2(up, Math.hypot(right, ahead));
        this.fit();
      }
      this.request();
    }

    depths(row, share) { // a quantile of how far off is what a station's camera may see
      const place = at(this.stations, row), [, , forward] = this.cameraAxes(row);
      const seen = this.sample.map((p) => plus(p, place, -1)).filter((p) => Math.hypot(...p) < 1.3 * dot(p, forward));
      const far = Float64Array.from(seen, (p) => dot(p, forward)).sort();
      return far.length ? far[Math.floor(share * far.length)] : share * this.radius;
    }

    lookAlong() { // behind the camera of the slider's frame and above it
      const place = at(this.stations, this.now), [, , forward] = this.cameraAxes(this.now), [right, up, ahead] = this.basis;
      const near = this.depths(this.now, 0.05), depth = this.depths(this.now, 0.5);
      const eye = plus(plus(place, forward, -0.6 * near - 1.5 * this.large), up, 0.25 * near + this.large);
      this.target = plus(place, forward, depth);
      const back = plus(eye, this.target, -1);
      this.distance = Math.hypot(...back);
      this.yaw = Math.atan2(dot(back, right), -dot(back, ahead));
      this.pitch = clamp(Math.asin(dot(back, up) / this.distance), -STEEPEST, STEEPEST);
    }

    turn(right, up) {
      this.yaw += right;
      this.pitch = clamp(this.pitch + up, -STEEPEST, STEEPEST);
      this.request();
    }

    perPixel() { return 2 * this.distance * Math.tan(FIELD / 2) / Math.max(this.canvas.clientHeight, 1); }

    pan(x, y) { // px
      const [right, up] = this.axes(), size = this.perPixel();
      this.target = plus(plus(this.target, right, -x * size), up, y * size);
      this.request();
    }

    zoom(factor) {
      this.distance = clamp(this.distance * factor, 1e-3 * this.radius, 50 * this.radius);
      this.request();
    }

    measure() { // a length of 1, 2 or 5 times a power of ten, where the view turns about
      const most = this.perPixel() * Math.min(130, 0.3 * this.canvas.clientWidth), power = 10 ** Math.floor(Math.log10(most));
      const length = power * [5, 2, 1].find((k) => k * power <= most), ruler = this.root.querySelector(".ruler");
      ruler.style.width = `${length / this.perPixel()}px`;
      ruler.textContent = length >= 1000 ? `${length / 1000} km` : length >= 1 ? `${length} m`
        : length >= 0.01 ? `${Math.round(100 * length)} cm` : `${Number((1000 * length).toPrecision(1))} mm`;
    }

    // ---- what people do ----

    listen() {
      const { canvas, form } = this;
      canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
      canvas.addEventListener("webglcontextrestored", () => { this.load(); this.stand(this.now); this.say(null); });
      this.listenToPointers();
      canvas.addEventListener("wheel", (event) => {
        event.preventDefault();
        this.zoom(Math.exp(clamp(event.deltaY * (event.deltaMode ? 20 : 1), -150, 150) * 0.0015));
      }, { passive: false });
      canvas.addEventListener("keydown", (event) => this.pressed(event));
      form.addEventListener("submit", (event) => event.preventDefault());
      form.addEventListener("change", (event) => { if (event.target.type !== "range") this.chosen(event.target); });
      for (const button of form.querySelectorAll("[data-view]")) {
        button.addEventListener("click", () => this.look(button.dataset.view));
      }
      this.slider = form.querySelector('input[type="range"]');
      this.slider?.addEventListener("input", () => { this.play(false); this.stand(Number(this.slider.value)); });
      form.querySelector(".play")?.addEventListener("click", () => this.play(!this.timer));
      let wasDrawn = false;
      new ResizeObserver(() => {
        if (!wasDrawn && canvas.clientWidth) { wasDrawn = true; this.look("first"); } else this.request();
      }).observe(canvas);
      const dark = matchMedia("(prefers-color-scheme: dark)");
      const themed = () => { this.isDark = dark.matches && !this.isPrinted; this.paint(); this.request(); };
      dark.addEventListener("change", themed);
      for (const [name, isPrinted] of [["beforeprint", true], ["afterprint", false]]) {
        addEventListener(name, () => { this.isPrinted = isPrinted; themed(); this.draw(); });
      }
      this.isDark = dark.matches;
    }

    listenToPointers() {
      const { canvas } = this, down = new Map();
      let moved = 0;
      const spread = () => {
        const [a, b] = [...down.values()];
        return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, size: Math.hypot(a.x - b.x, a.y - b.y) };
      };
      canvas.addEventListener("contextmenu", (event) => event.preventDefault());
      canvas.addEventListener("pointerdown", (event) => {
        if (!down.size) moved = 0;
        canvas.setPointerCapture(event.pointerId);
        down.set(event.pointerId, { x: event.clientX, y: event.clientY });
      });
      canvas.addEventListener("pointermove", (event) => {
        const was = down.get(event.pointerId);
        if (!was) return;
        const before = down.size === 2 ? spread() : null, x = event.clientX - was.x, y = event.clientY - was.y;
        down.set(event.pointerId, { x: event.clientX, y: event.clientY });
        moved += Math.abs(x) + Math.abs(y);
        if (before) {
          const after = spread();
          this.zoom(before.size / Math.max(after.size, 1));
          this.pan(after.x - before.x, after.y - before.y);
          moved += 99;
        } else if (down.size === 1) {
          if (event.shiftKey || event.buttons & 6) this.pan(x, y);
          else this.turn(-x * TURN, y * TURN);
        }
      });
      const lifted = (event) => {
        if (down.delete(event.pointerId) && event.type === "pointerup" && moved < 6 && event.button === 0) this.pick(event);
      };
      canvas.addEventListener("pointerup", lifted);
      canvas.addEventListener("pointercancel", lifted);
    }

    pressed(event) {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const [x, y] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] || [0, 0];
      if (x || y) event.shiftKey ? this.pan(-40 * x, 40 * y) : this.turn(x * STEP, y * STEP);
      else if (event.key === "+" || event.key === "=") this.zoom(0.85);
      else if (event.key === "-" || event.key === "_") this.zoom(1 / 0.85);
      else if (event.key === "0") this.look("first");
      else return;
      event.preventDefault();
    }

    chosen(input = null) { // a switch was pressed
      if (!input || input.name === "layer") {
        this.layer = this.layers[Number(new FormData(this.form).get("layer"))] ?? null;
        for (const [name, level] of [["edges", "edge"], ["points", "vertex"]]) { // shown with their layer, gone with it
          const box = this.form.elements[name];
          if (!box || (name === "points" && this.count.face)) continue;
          if (this.layer?.level === level && !box.checked) { box.checked = true; this.lent = name; }
          else if (this.lent === name && this.layer?.level !== level) { box.checked = false; this.lent = null; }
        }
        this.legend();
        this.say(null);
      } else {
        if (this.lent === input.name) this.lent = null;
        this.legend();
      }
      if (!input || ["layer", "ceiling"].includes(input.name)) this.paint();
      this.named();
      this.request();
    }

    named() {
      const { vertex, edge, face } = this.count, what = { map: "The map", mesh: "The mesh", points: "The points" };
      const path = this.numbers.length > 1 ? `, the camera's path with ${this.numbers.length} places` : "";
      const by = this.layer ? `; coloured by: ${this.layer.label}` : "";
      this.canvas.setAttribute("aria-label", `${what[this.meta.what]} in space: ${vertex} vertices, ${edge} edges, `
        + `${face} faces${path}${by}. Arrow keys turn it, plus and minus zoom, 0 shows all.`);
    }

    // ---- along the path ----

    stand(row) {
      this.now = row;
      const pen = new Pen();
      this.frustum(pen, row, this.large, NOW);
      this.camera.set(pen.arrays());
      this.request();
      if (!this.slider) return;
      const words = `frame ${this.numbers[row]}, ${this.isKnown(row) ? STATES[this.states[row]] : "lost"}`;
      this.slider.value = row;
      this.slider.setAttribute("aria-valuetext", words);
      this.form.querySelector(".time output").textContent = words;
      this.showThumb(row);
    }

    showThumb(row) { // the nearest picture at or before it that the page has
      const { thumb } = this;
      for (let k = row; k >= 0; k--) {
        const found = document.querySelector(`img[data-frame="${this.numbers[k]}"]`);
        if (!found?.src) continue;
        if (thumb.src !== found.src) thumb.src = found.src;
        thumb.alt = `Left image of frame ${this.numbers[k]}`;
        thumb.hidden = false;
        return;
      }
      thumb.hidden = true;
    }

    play(isOn) {
      clearInterval(this.timer);
      this.timer = null;
      const button = this.form.querySelector(".play"), last = this.numbers.length - 1;
      button.textContent = isOn ? "Pause" : "Play";
      this.form.querySelector(".time output").setAttribute("aria-live", isOn ? "off" : "polite");
      if (!isOn) return;
      if (this.now >= last) this.stand(0);
      const pause = clamp(1000 * LAP / last, 40, 400), stride = Math.max(1, Math.round(pause * last / (1000 * LAP)));
      this.timer = setInterval(() => {
        this.stand(Math.min(this.now + stride, last));
        if (this.now >= last) this.play(false);
      }, pause);
    }

    // ---- what is where the pointer is ----

    pick(event) {
      const box = this.canvas.getBoundingClientRect(), [right, up, back] = this.axes(), half = Math.tan(FIELD / 2);
      const x = (2 * (event.clientX - box.left) / box.width - 1) * half * box.width / box.height;
      const y = (1 - 2 * (event.clientY - box.top) / box.height) * half;
      const ray = unit(plus(plus(back.map((v) => -v), right, x), up, y));
      const mouse = [event.clientX - box.left, event.clientY - box.top];
      const hit = this.on("surface") ? this.hitFace(this.eye(), ray) : null;
      const level = this.layer?.level ?? "face";
      const reach = hit ? hit.far * 1.02 : Infinity;
      if (level === "face") this.say(hit && { level, row: hit.face });
      else if (level === "edge") this.say(this.hitEdge(mouse, reach));
      else this.say(hit ? { level, row: this.nearestCorner(hit, ray) } : this.hitPoint(mouse, reach));
    }

    hitFace(eye, ray) { // Moeller and Trumbore's test of every face
      let found = null;
      const hides = !this.on("ceiling");
      for (let f = 0; f < this.count.face; f++) {
        if (hides && !this.isBelow[f]) continue;
        const [a, b, c] = [0, 1, 2].map((k) => at(this.places, this.corners[3 * f + k]));
        const u = plus(b, a, -1), v = plus(c, a, -1), p = cross(ray, v), size = dot(u, p);
        if (Math.abs(size) < 1e-18) continue;
        const t = plus(eye, a, -1), s = dot(t, p) / size, q = cross(t, u), w = dot(ray, q) / size;
        if (s < 0 || w < 0 || s + w > 1) continue;
        const far = dot(v, q) / size;
        if (far > 0 && (!found || far < found.far)) found = { face: f, far };
      }
      return found;
    }

    nearestCorner({ face, far }, ray) {
      const place = plus(this.eye(), ray, far), corners = [...this.corners.subarray(3 * face, 3 * face + 3)];
      const away = (v) => Math.hypot(...plus(at(this.places, v), place, -1));
      return corners.reduce((best, v) => (away(v) < away(best) ? v : best));
    }

    project(p) { // px, and how far along the view
      const m = this.view, [x, y, w] = [0, 1, 3].map((k) => m[k] * p[0] + m[4 + k] * p[1] + m[8 + k] * p[2] + m[12 + k]);
      const { clientWidth, clientHeight } = this.canvas;
      return w > 0 ? [(x / w + 1) / 2 * clientWidth, (1 - y / w) / 2 * clientHeight, w] : null;
    }

    hitPoint(mouse, reach) {
      return this.nearest("vertex", this.count.vertex, reach, (v) => {
        const p = this.hides(v) ? null : this.project(at(this.places, v));
        return p && [Math.hypot(p[0] - mouse[0], p[1] - mouse[1]), p[2]];
      });
    }

    hitEdge(mouse, reach) {
      return this.nearest("edge", this.count.edge, reach, (e) => {
        const [v, w] = [this.ends[2 * e], this.ends[2 * e + 1]];
        const [a, b] = this.hides(v) || this.hides(w) ? [] : [v, w].map((k) => this.project(at(this.places, k)));
        if (!a || !b) return null;
        const [x, y] = [b[0] - a[0], b[1] - a[1]], [mx, my] = [mouse[0] - a[0], mouse[1] - a[1]];
        const t = clamp((mx * x + my * y) / Math.max(x * x + y * y, 1e-9), 0, 1);
        return [Math.hypot(mx - t * x, my - t * y), a[2] + t * (b[2] - a[2])];
      });
    }

    hides(vertex) { return !this.on("ceiling") && !this.isLow[vertex]; }

    nearest(level, count, reach, measure) {
      let best = null;
      for (let row = 0; row < count; row++) {
        const [off, depth] = measure(row) || [Infinity, 0];
        if (off < NEAR && depth <= reach && (!best || off < best.off)) best = { level, row, off };
      }
      return best;
    }

    say(found) { // in a line, and by a mark
      const pen = new Pen(), dots = [], said = this.root.querySelector(".said");
      if (!found) said.textContent = ASK;
      else {
        const { level, row } = found, from = { vertex: [row], edge: this.ends, face: this.corners }[level];
        const size = { vertex: 1, edge: 2, face: 3 }[level], start = level === "vertex" ? 0 : size * row;
        const corners = [...from.slice(start, start + size)].map((v) => at(this.places, v));
        corners.forEach((a, k) => { if (size > 1) pen.line(a, corners[(k + 1) % size], PICKED); else dots.push(...a); });
        const [x, y, z] = plus(corners.reduce((a, b) => plus(a, b)).map((v) => v / size), this.origin);
        const place = [["right", x], ["down", y], ["forward", z]].map(([w, v]) => `${w} ${minus(v.toFixed(2))}`).join(", ");
        const name = `${level[0].toUpperCase()}${level.slice(1)} ${this.rows[level][row]}`;
        said.textContent = `${name} at ${place} m${this.layer?.level === level ? `: ${this.words(this.layer, row)}` : ""}`;
      }
      this.marks.set(pen.arrays());
      this.mark.set([[new Float32Array(dots), 3], [new Uint8Array(dots.length ? PICKED : []), 4]]);
      this.request();
    }

    words(layer, row) { // the value, to what a step of its scale tells
      const { label, unit: given, name, scale } = layer;
      if (!layer.ok[row]) return `${label}: no value`;
      if (name === "direction") {
        const [x, y, z] = this.direction(layer, row).map((v) => minus(v.toFixed(1)));
        return `${label}: right ${x}, down ${y}, forward ${z}`;
      }
      if (scale === "rgb") return `${label}: red, green and blue ${at(layer.steps, row).join(", ")} of 255`;
      const [low, high] = layer.span, step = layer.steps[row], value = low + step / 255 * (high - low);
      const digits = clamp(Math.ceil(-Math.log10((high - low) / 255)), 0, 9);
      let words = layer.log ? String(Number((10 ** value).toPrecision(2))) : value.toFixed(given === "keyframes" ? 0 : digits);
      if (scale !== "phase" && step === 0 && given !== "keyframes") words = `${words} or less`;
      if (scale !== "phase" && step === 255 && given !== "keyframes") words = `${words} or more`;
      const plain = ["m", "keyframes"].includes(given) ? ` ${given}` : ` (${given})`;
      return `${label}: ${minus(words)}${/\[.+\]/.test(given) ? ` ${given.match(/\[(.+)\]/)[1]}` : plain}`;
    }

    // ---- legend ----

    legend() {
      const box = this.root.querySelector(".legend"), { layer } = this, parts = [];
      if (layer && layer.scale !== "rgb") parts.push(layer.scale === "phase" ? this.wheel(layer) : this.bar(layer));
      if (layer) {
        const words = element("p"), isTold = layer.label.toLowerCase().includes(layer.unit);
        words.append(element("b", isTold ? `${layer.label}. ` : `${layer.label}, ${layer.unit}. `), layer.note);
        parts.push(words);
      }
      box.replaceChildren(...parts, this.keys());
    }

    hue(layer, share) { return rgb([...at(this.tables[layer.scale], Math.round(255 * share))]); }

    bar(layer) {
      const made = element("div", "", "scale"), strip = element("i"), ticks = element("div");
      const shares = Array.from({ length: 33 }, (_, k) => k / 32);
      strip.style.background = `linear-gradient(to right, ${shares.map((x) => this.hue(layer, x)).join(", ")})`;
      let last = -1;
      for (const [share, words] of layer.ticks) {
        if (share - last < 0.11) continue; // two would overlap
        last = share;
        const tick = element("span", minus(words));
        tick.style.left = `${100 * share}%`;
        ticks.append(tick);
      }
      made.append(strip, ticks);
      return made;
    }

    wheel(layer) { // as in the image: 0 points right, a quarter of a turn down
      const made = element("div", "", "wheel"), ring = element("i");
      const shares = Array.from({ length: 49 }, (_, k) => k / 48);
      ring.style.background = `conic-gradient(from 270deg, ${shares.map((x) => this.hue(layer, x)).join(", ")})`;
      made.append(ring);
      for (const [share, words] of layer.ticks.slice(1)) {
        const angle = 2 * Math.PI * share - Math.PI, tick = element("span", words);
        tick.style.left = `${50 + 82 * Math.cos(angle)}%`;
        tick.style.top = `${50 + 76 * Math.sin(angle)}%`;
        made.append(tick);
      }
      return made;
    }

    keys() { // what lines and dots are
      const list = element("ul", "", "keys"), states = new Set([...this.states].map((k) => STATES[k]));
      const add = (colour, words, name = "") => {
        const item = element("li"), sample = element("i", "", name);
        sample.style[name === "dot" ? "background" : "borderColor"] = rgb(colour);
        item.append(sample, words);
        list.append(item);
      };
      if (this.numbers.length > 1) {
        add(PATH, "path and keyframes");
        add(NOW, "camera of the slider's frame");
        if (states.has("weak")) add(WEAK, "few landmarks seen");
        if (states.has("lost")) add(LOST, "lost");
        if (states.has("loop")) add(LOOP, "loop closed", "dot");
      } else if (this.numbers.length) add(NOW, "camera");
      this.others.forEach(({ words }, k) => add(OTHERS[k % 3], words, "dashed"));
      if (this.on("strokes")) add(HEAD, "directions, from dark to bright: blue to yellow");
      if (!this.layer || this.layer.ok.includes(0)) add(this.meta.bare, "no value, clear", "dot");
      return list;
    }
  }

  const minus = (words) => String(words).replace("-", "\u2212");

  for (const root of document.querySelectorAll(".space:not([data-on])")) {
    root.dataset.on = "";
    new Scene(root);
  }
})();
