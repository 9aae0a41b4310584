// From where it is seen: about a target, upright.
const FIELD = 0.7; // rad, from the top of the picture to its bottom
const STEEPEST = Math.PI / 2 - 1e-3;
const FITTED = 0.99; // of the vertices are in the first view: the last few would make it small

class Camera {
  constructor(model, canvas) { Object.assign(this, { model, canvas, target: [0, 0, 0], distance: 1, yaw: 0, pitch: 0 }); }

  axes() { // right and up of the picture, and from it to the viewer
    const [right, up, ahead] = this.model.basis, { yaw, pitch } = this;
    const level = plus(right.map((x) => x * Math.sin(yaw)), ahead, -Math.cos(yaw));
    const back = plus(level.map((x) => x * Math.cos(pitch)), up, Math.sin(pitch));
    const across = unit(cross(up, level));
    return [across, cross(back, across), back];
  }

  eye() { return plus(this.target, this.axes()[2], this.distance); }

  matrix() { // column by column; kept for `project`
    const [x, y, z] = this.axes(), eye = this.eye(), { radius } = this.model, { clientWidth, clientHeight } = this.canvas;
    const far = this.distance + Math.hypot(...this.target) + 6 * radius;
    const near = Math.max(Math.min(this.distance, radius) * 0.02, far * 2e-5);
    const f = 1 / Math.tan(FIELD / 2), a = f * clientHeight / clientWidth;
    const c = (far + near) / (near - far), d = 2 * far * near / (near - far);
    const t = [-dot(x, eye), -dot(y, eye), -dot(z, eye)];
    this.view = new Float32Array([
      a * x[0], f * y[0], c * z[0], -z[0], a * x[1], f * y[1], c * z[1], -z[1],
      a * x[2], f * y[2], c * z[2], -z[2], a * t[0], f * t[1], c * t[2] + d, -t[2],
    ]);
    return this.view;
  }

  project(p) { // px, and how far along the view; null behind the viewer
    const m = this.view, [x, y, w] = [0, 1, 3].map((k) => m[k] * p[0] + m[4 + k] * p[1] + m[8 + k] * p[2] + m[12 + k]);
    const { clientWidth, clientHeight } = this.canvas;
    return w > 0 ? [(x / w + 1) / 2 * clientWidth, (1 - y / w) / 2 * clientHeight, w] : null;
  }

  ray([x, y]) { // through a pixel, from the eye
    const [right, up, back] = this.axes(), size = 2 * Math.tan(FIELD / 2) / this.canvas.clientHeight;
    const off = [(x - this.canvas.clientWidth / 2) * size, (this.canvas.clientHeight / 2 - y) * size];
    return unit(plus(plus(back.map((v) => -v), right, off[0]), up, off[1]));
  }

  fit() { // target and distance with which nearly all, and the path, fill the picture, whatever its shape
    const { model, canvas } = this, [x, y, z] = this.axes(), inside = (p) => [dot(p, x), dot(p, y), dot(p, z)];
    const every = Math.ceil(model.known.length / SAMPLED), known = model.isPath ? model.known : [];
    const path = known.filter((_, k) => k % every === 0).map((k) => at(model.stations, k));
    const high = Math.tan(FIELD / 2) * 0.92, wide = high * canvas.clientWidth / Math.max(canvas.clientHeight, 1);
    const surface = model.sample.map(inside), way = path.map(inside), all = [...surface, ...way];
    const cut = Math.floor((1 - FITTED) * surface.length);
    const centre = [0, 1, 2].map((k) => {
      const values = sorted(all.map((p) => p[k]));
      return (values[cut] + values[values.length - 1 - cut]) / 2;
    });
    const need = (p) => p[2] - centre[2] + Math.max(Math.abs(p[0] - centre[0]) / wide, Math.abs(p[1] - centre[1]) / high);
    const limit = sorted(surface.map(need))[Math.max(surface.length - 1 - cut, 0)];
    const seen = [...surface.filter((p) => need(p) <= limit), ...way]; // the path is never cut off
    const reach = () => Math.max(...seen.map(need), 1e-6);
    for (let round = 0; round < 4; round++) { // near things take more of the picture: its middle moves
      const distance = reach();
      for (const k of [0, 1]) {
        const off = seen.map((p) => (p[k] - centre[k]) / Math.max(distance - p[2] + centre[2], 1e-9));
        centre[k] += distance * (Math.min(...off) + Math.max(...off)) / 2;
      }
    }
    this.distance = reach();
    this.target = plus(plus(x.map((v) => v * centre[0]), y, centre[1]), z, centre[2]);
  }

  look(name, station) {
    if (name === "path" && this.model.isKnown(station)) this.lookAlong(station);
    else if (name === "above") {
      this.pitch = STEEPEST;
      const tried = [0, Math.PI / 2].map((yaw) => { this.yaw = yaw; this.fit(); return this.distance; });
      this.yaw = tried[0] <= tried[1] ? 0 : Math.PI / 2; // its longer side across
      this.fit();
    } else {
      const [right, up, ahead] = this.model.meta.eye;
      this.yaw = Math.atan2(right, -ahead);
      this.pitch = Math.atan2(up, Math.hypot(right, ahead));
      this.fit();
    }
  }

  lookAlong(station) { // from behind the camera of a station, and above it
    const { model } = this, place = at(model.stations, station), [, , forward] = model.cameraAxes(station);
    const [right, up, ahead] = model.basis, near = model.depth(station, 0.05);
    const eye = plus(plus(place, forward, -0.6 * near - 1.5 * model.large), up, 0.25 * near + model.large);
    this.target = plus(place, forward, model.depth(station, 0.5));
    const back = plus(eye, this.target, -1);
    this.distance = Math.hypot(...back);
    this.yaw = Math.atan2(dot(back, right), -dot(back, ahead));
    this.pitch = clamp(Math.asin(dot(back, up) / this.distance), -STEEPEST, STEEPEST);
  }

  turn(right, up) {
    this.yaw += right;
    this.pitch = clamp(this.pitch + up, -STEEPEST, STEEPEST);
  }

  perPixel() { return 2 * this.distance * Math.tan(FIELD / 2) / Math.max(this.canvas.clientHeight, 1); } // m, at the target

  pan(x, y) { // px
    const [right, up] = this.axes(), size = this.perPixel();
    this.target = plus(plus(this.target, right, -x * size), up, y * size);
  }

  zoom(factor) { this.distance = clamp(this.distance * factor, 1e-3 * this.model.radius, 50 * this.model.radius); }
}
