// Shaders, and what the graphics card holds.
const FACES = [
  `#version 300 es
  uniform mat4 view; in vec3 place; in vec4 tint; out vec3 at; out vec4 colour;
  void main() { at = place; colour = tint; gl_Position = view * vec4(place, 1.0); }`,
  `#version 300 es
  precision highp float;
  uniform vec3 light; uniform bool isClear; in vec3 at; in vec4 colour; out vec4 seen;
  void main() { // flat, from both sides alike
    if (colour.a < 0.02 || (colour.a < 0.99) != isClear) discard;
    vec3 across = cross(dFdx(at), dFdy(at));
    float shade = 0.84 + 0.2 * abs(dot(across, light)) / max(length(across), 1e-20);
    seen = vec4(min(colour.rgb * shade, 1.0), colour.a);
  }`,
];
const LINES = [ // each a strip of two triangles, as wide as asked in px
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

class Batch { // one array an attribute, of vertices, or of instances where the divisor is 1
  constructor(gl, arrays, divisor) {
    Object.assign(this, { gl, divisor, vao: gl.createVertexArray(), buffers: [] });
    this.set(arrays);
  }

  set(arrays) { // each [values, numbers an element, first of these, of how many in all]; null: as it was
    const { gl } = this;
    gl.bindVertexArray(this.vao);
    arrays.forEach((entry, place) => {
      if (!entry) return;
      const [values, size, first = 0, all = size] = entry, bytes = values.BYTES_PER_ELEMENT;
      this.buffers[place] ??= gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[place]);
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      const isByte = values instanceof Uint8Array;
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, isByte ? gl.UNSIGNED_BYTE : gl.FLOAT, isByte, all * bytes, first * bytes);
      gl.vertexAttribDivisor(place, this.divisor);
      this.count = values.length / all;
    });
    gl.bindVertexArray(null);
  }
}

const dotArrays = (places, colours) => [places && [places, 3], colours && [colours, 4]];
const lineArrays = (ends, colours, along) => [
  ends && [ends, 3, 0, 6], ends && [ends, 3, 3, 6], colours && [colours, 4, 0, 8], colours && [colours, 4, 4, 8],
  along && [along, 2],
];

class Pen { // lines one by one, with how far along a dashed line each begins and ends
  constructor() { Object.assign(this, { ends: [], colours: [], along: [] }); }

  line(a, b, colour, end = colour, from = 0, to = 0) {
    this.ends.push(...a, ...b);
    this.colours.push(...colour, ...end);
    this.along.push(from, to);
  }

  arrays() {
    return lineArrays(new Float32Array(this.ends), new Uint8Array(this.colours), new Float32Array(this.along));
  }
}
