// The picture: what the card holds of a model, in the colours of a layer.
class Drawing {
  constructor(gl, model) {
    Object.assign(this, { gl, model });
    this.load();
  }

  load() { // also after a lost context
    const { gl, model } = this;
    this.programs = {
      faces: program(gl, FACES, ["place", "tint"]),
      lines: program(gl, LINES, ["start", "end", "startTint", "endTint", "along"]),
      points: program(gl, POINTS, ["place", "tint"]),
    };
    this.faces = new Batch(gl, dotArrays(this.placesOf(model.corners)), 0);
    this.edges = new Batch(gl, lineArrays(this.placesOf(model.ends), null, new Float32Array(model.ends.length)), 1);
    this.points = new Batch(gl, dotArrays(model.places), 0);
    const loops = model.known.filter((k) => model.states[k] === "loop"), dots = loops.flatMap((k) => at(model.stations, k));
    this.loops = new Batch(gl, dotArrays(new Float32Array(dots), new Uint8Array(loops.flatMap(() => LOOP))), 0);
    this.path = this.drawn((pen) => this.pathLines(pen));
    this.others = this.drawn((pen) => model.others.forEach((x, k) => this.otherLines(pen, x.places, OTHERS[k % 3])));
    this.strokes = this.drawn((pen) => this.strokeLines(pen));
    const keys = model.isPath ? model.known.filter((k) => model.isKey(k)) : [];
    this.frustums = this.drawn((pen) => keys.forEach((k) => this.frustum(pen, k, model.small, PATH)));
    this.camera = this.drawn(() => {});
    this.outline = this.drawn(() => {});
    this.spot = new Batch(gl, dotArrays(new Float32Array(0), new Uint8Array(0)), 0);
  }

  placesOf(vertices) {
    const { places } = this.model, made = new Float32Array(3 * vertices.length);
    vertices.forEach((v, k) => made.set(places.subarray(3 * v, 3 * v + 3), 3 * k));
    return made;
  }

  drawn(draw) {
    const pen = new Pen();
    draw(pen);
    return new Batch(this.gl, pen.arrays(), 1);
  }

  pathLines(pen) { // each piece in the colour of the frame at its end
    const { model } = this, tints = { lost: LOST, weak: WEAK };
    for (let k = 1; k < model.numbers.length; k++) {
      if (!model.isKnown(k - 1) || !model.isKnown(k)) continue;
      pen.line(at(model.stations, k - 1), at(model.stations, k), tints[model.states[k]] ?? PATH);
    }
  }

  otherLines(pen, places, colour) {
    let way = 0;
    for (let k = 1; k < places.length / 3; k++) {
      const a = at(places, k - 1), b = at(places, k), length = apart(a, b);
      if (!Number.isFinite(length)) continue;
      pen.line(a, b, colour, colour, way, way + length);
      way += length;
    }
  }

  strokeLines(pen) { // along the response's direction
    const { model } = this, layer = model.layers.find((x) => x.name === "direction");
    for (let v = 0; layer && v < model.count.vertex; v++) {
      if (!layer.ok[v] || model.hides(v, true)) continue;
      const a = at(model.places, v);
      pen.line(a, plus(a, unit(model.direction(layer, v)), model.stroke), TAIL, HEAD);
    }
  }

  frustum(pen, row, size, colour) { // a camera, with a roof over its image
    const { model } = this, eye = at(model.stations, row), [right, down, forward] = model.cameraAxes(row);
    const [left, top, rightmost, bottom] = model.meta.camera;
    const scale = size / Math.max(rightmost - left, bottom - top, 1); // wide angles stay small
    const corner = (x, y) => plus(plus(plus(eye, right, x * scale), down, y * scale), forward, scale);
    const image = [corner(left, top), corner(rightmost, top), corner(rightmost, bottom), corner(left, bottom)];
    image.forEach((c, k) => { pen.line(eye, c, colour); pen.line(c, image[(k + 1) % 4], colour); });
    const peak = corner((left + rightmost) / 2, top - 0.3 * (bottom - top));
    pen.line(image[0], peak, colour);
    pen.line(peak, image[1], colour);
  }

  stand(row) { // the slider's frame
    const pen = new Pen();
    if (this.model.isKnown(row)) this.frustum(pen, row, this.model.large, NOW);
    this.camera.set(pen.arrays());
  }

  mark(corners) { // around what was clicked
    const pen = new Pen(), isSpot = corners.length === 1;
    if (!isSpot) corners.forEach((a, k) => pen.line(a, corners[(k + 1) % corners.length], PICKED));
    this.outline.set(pen.arrays());
    this.spot.set(dotArrays(new Float32Array(isSpot ? corners[0] : []), new Uint8Array(isSpot ? PICKED : [])));
  }

  paint(layer, isOpen, isDark) { // colours of all elements; without the ceiling if it is open
    const { model } = this, { count, corners, ends, keeps } = model, level = layer ? layer.level : "none";
    const pale = isDark ? [58, 72, 90, 255] : [168, 184, 204, 255], plain = [...PLAIN.slice(0, 3), 255];
    const faces = new Uint8Array(4 * corners.length), lines = new Uint8Array(4 * ends.length);
    const dots = new Uint8Array(4 * count.vertex);
    for (let f = 0; f < count.face; f++) {
      if (isOpen && !keeps.face[f]) continue;
      const isSmooth = level === "vertex" && [0, 1, 2].every((c) => layer.ok[corners[3 * f + c]]);
      for (let c = 0; c < 3; c++) {
        const k = 4 * (3 * f + c);
        if (level === "edge") faces.set(pale, k);
        else if (isSmooth) model.colour(layer, corners[3 * f + c], faces, k);
        else model.colour(level === "face" ? layer : null, f, faces, k);
      }
    }
    for (let k = 0; k < ends.length; k++) {
      if (model.hides(ends[k - k % 2], isOpen) || model.hides(ends[k - k % 2 + 1], isOpen)) continue;
      if (level === "edge") model.colour(layer, k >> 1, lines, 4 * k);
      else lines.set(PLAIN, 4 * k);
    }
    for (let v = 0; v < count.vertex; v++) {
      if (model.hides(v, isOpen)) continue;
      if (level === "vertex") model.colour(layer, v, dots, 4 * v);
      else dots.set(plain, 4 * v);
    }
    this.faces.set(dotArrays(null, faces));
    this.edges.set(lineArrays(null, lines, null));
    this.points.set(dotArrays(null, dots));
    this.isBold = level === "edge";
  }

  draw(view, paper, ratio, on) { // `on` tells what is shown
    const { gl } = this, { width, height } = gl.canvas;
    Object.assign(this, { view, paper, ratio });
    gl.viewport(0, 0, width, height);
    gl.clearColor(...paper.map((x) => x / 255), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    if (on("surface")) this.drawFaces(false);
    if (on("edges")) this.drawLines(this.edges, this.isBold ? 1.6 : 1, 2e-5);
    if (on("strokes")) this.drawLines(this.strokes, 2, 1e-4);
    if (on("points")) this.drawPoints(this.points, 4.5, 5e-5);
    if (on("surface")) this.drawFaces(true);
    if (on("path")) {
      this.drawLines(this.others, 2.5, 2e-4, { dash: 0.02 * this.model.radius });
      this.drawLines(this.path, 3.5, 2e-4, { halo: true });
      this.drawPoints(this.loops, 11, 3e-4);
    }
    if (on("frustums")) {
      this.drawLines(this.frustums, 1.3, 1e-4);
      this.drawLines(this.camera, 2.6, 3e-4, { halo: true });
    }
    this.drawLines(this.outline, 3, 1e-3, { halo: true });
    this.drawPoints(this.spot, 12, 1e-3);
  }

  start(kind, batch) {
    const { gl } = this, { program: made, uniforms } = this.programs[kind];
    gl.useProgram(made);
    gl.uniformMatrix4fv(uniforms.view, false, this.view);
    gl.bindVertexArray(batch.vao);
    return uniforms;
  }

  drawFaces(isClear) {
    const { gl } = this, uniforms = this.start("faces", this.faces), [right, up, ahead] = this.model.basis;
    const light = plus(plus(up.map((x) => 0.48 * x), right, -0.35), ahead, -0.79); // from above left, behind the start
    gl.uniform3fv(uniforms.light, unit(light));
    gl.uniform1i(uniforms.isClear, isClear);
    gl.enable(gl.POLYGON_OFFSET_FILL); // what lies on the surface is before it
    gl.polygonOffset(1, 1);
    gl.depthMask(!isClear);
    gl.drawArrays(gl.TRIANGLES, 0, this.faces.count);
    gl.depthMask(true);
    gl.disable(gl.POLYGON_OFFSET_FILL);
  }

  drawLines(batch, width, lift, { dash = 0, halo = false } = {}) {
    const { gl } = this, uniforms = this.start("lines", batch);
    gl.uniform2f(uniforms.size, gl.canvas.width, gl.canvas.height);
    gl.uniform1f(uniforms.dash, dash);
    for (const extra of halo ? [2.5, 0] : [0]) {
      gl.uniform4fv(uniforms.cover, extra ? [...this.paper.map((x) => x / 255), 1] : [0, 0, 0, 0]);
      gl.uniform1f(uniforms.width, (width + extra) * this.ratio);
      gl.uniform1f(uniforms.lift, lift);
      gl.depthMask(!extra); // no halo hides a line
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, batch.count);
    }
  }

  drawPoints(batch, width, lift) {
    const { gl } = this, uniforms = this.start("points", batch);
    gl.uniform1f(uniforms.width, width * this.ratio);
    gl.uniform1f(uniforms.lift, lift);
    gl.drawArrays(gl.POINTS, 0, batch.count);
  }
}
