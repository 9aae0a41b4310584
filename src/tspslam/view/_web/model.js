// What is shown: the arrays of _space.py, unpacked, in metres from the middle of it all.
const KINDS = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, i2: Int16Array, i4: Int32Array, f4: Float32Array };

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

class Model {
  constructor(packed) {
    const { meta } = packed, array = (entry) => packed.array(entry);
    this.meta = meta;
    const steps = array(meta.places), n = steps.length / 3, middle = meta.quantum.map((x) => x * 32767.5);
    this.corners = array(meta.faces);
    this.ends = array(meta.edges);
    this.count = { vertex: n, edge: this.ends.length / 2, face: this.corners.length / 3 };
    this.origin = plus(meta.low, middle);
    this.places = new Float32Array(3 * n);
    for (let k = 0; k < 3 * n; k++) this.places[k] = steps[k] * meta.quantum[k % 3] - middle[k % 3];
    this.rows = {};
    for (const level of ["vertex", "edge", "face"]) this.rows[level] = packed.rows(meta.rows[level], this.count[level]);
    this.tables = Object.fromEntries(Object.entries(meta.tables).map(([name, entry]) => [name, array(entry)]));
    this.layers = meta.layers.map((layer) => (
      { ...layer, steps: array(layer.steps), ok: packed.mask(layer.ok, this.count[layer.level]) }
    ));
    const up = unit(meta.up), ahead = unit(meta.ahead);
    this.basis = [cross(ahead, up), up, ahead]; // right, up, ahead
    this.readCeiling(packed);
    this.readPath(packed);
    this.measure();
  }

  readCeiling(packed) { // faces and vertices that stay when it is taken off
    const { ceiling } = this.meta;
    this.keeps = { face: packed.mask(ceiling, this.count.face), vertex: new Uint8Array(this.count.vertex).fill(1) };
    if (!ceiling) return;
    const other = new Uint8Array(this.count.vertex);
    this.corners.forEach((v, k) => { if (this.keeps.face[Math.floor(k / 3)]) other[v] = 1; });
    this.corners.forEach((v) => { this.keeps.vertex[v] = other[v]; });
  }

  readPath(packed) {
    const local = (entry) => packed.array(entry).map((x, k) => x - this.origin[k % 3]);
    const { numbers, states, places, axes } = this.meta.stations;
    this.numbers = packed.array(numbers);
    this.states = Array.from(packed.array(states), (k) => STATES[k]);
    this.stations = local(places);
    this.axes = packed.array(axes); // right and down, 32767 to one
    this.others = this.meta.others.map(({ words, places: entry }) => ({ words, places: local(entry) }));
    this.known = [...this.numbers.keys()].filter((k) => this.isKnown(k));
    this.isPath = this.numbers.length > 1;
  }

  measure() { // how large the whole is, cameras are drawn, strokes are long
    const { vertex, edge } = this.count, every = Math.ceil(vertex / SAMPLED), step = Math.ceil(edge / SAMPLED);
    this.sample = [];
    for (let v = 0; v < vertex; v += every) this.sample.push(at(this.places, v));
    const spans = [0, 1, 2].map((k) => {
      const values = sorted(this.sample.map((p) => p[k])), cut = Math.floor(0.005 * values.length);
      return values[values.length - 1 - cut] - values[cut];
    });
    this.radius = Math.max(Math.hypot(...spans) / 2, 1e-6);
    const lengths = [];
    for (let k = 0; k < edge; k += step) lengths.push(apart(...[0, 1].map((c) => at(this.places, this.ends[2 * k + c]))));
    this.stroke = 0.7 * (sorted(lengths)[lengths.length >> 1] || 0.01 * this.radius);
    const keys = this.known.filter((k) => this.isKey(k));
    const gaps = keys.slice(1).map((k, j) => apart(at(this.stations, k), at(this.stations, keys[j])));
    const gap = sorted(gaps)[gaps.length >> 1] || this.radius;
    this.small = clamp(0.45 * gap, 0.008 * this.radius, 0.035 * this.radius); // m, of a keyframe's camera
    this.large = Math.max(2.2 * this.small, 0.045 * this.radius); // of the slider's
    if (!this.isPath && this.known.length) { // a single camera is smaller than what is before it
      this.large = clamp(0.5 * this.depth(0, 0.05), 0.003 * this.radius, 0.045 * this.radius);
    }
  }

  isKnown(row) { return Number.isFinite(this.stations[3 * row]); }

  isKey(row) { return this.states[row] === "keyframe" || this.states[row] === "loop"; }

  cameraAxes(row) { // right, down and forward of a station's camera
    const [right, down] = [0, 3].map((first) => unit([0, 1, 2].map((c) => this.axes[6 * row + first + c])));
    return [right, down, cross(right, down)];
  }

  depth(row, share) { // a quantile of how far off is what a station's camera may see, m
    const place = at(this.stations, row), [, , forward] = this.cameraAxes(row);
    const seen = this.sample.map((p) => plus(p, place, -1)).filter((p) => Math.hypot(...p) < 1.3 * dot(p, forward));
    const far = sorted(seen.map((p) => dot(p, forward)));
    return far.length ? far[Math.floor(share * far.length)] : share * this.radius;
  }

  hides(vertex, isOpen) { return isOpen && !this.keeps.vertex[vertex]; }

  direction(layer, row) { // right, down, forward; of the colours: red right, green up, blue forward
    const [r, g, b] = at(layer.steps, row).map((x) => x / 127.5 - 1);
    return [r, -g, b];
  }

  colour(layer, row, into, k) { // of an element into four bytes from the k-th; clear where there is no value
    const isBare = !layer || !layer.ok[row], isPlain = !isBare && layer.scale === "rgb";
    const from = isBare ? this.meta.bare : isPlain ? layer.steps : this.tables[layer.scale];
    const first = isBare ? 0 : 3 * (isPlain ? row : layer.steps[row]);
    for (let c = 0; c < 3; c++) into[k + c] = from[first + c];
    into[k + 3] = isBare ? 102 : 255;
  }
}
