// A surface with what it is coloured by, and a camera's path, to turn: WebGL 2, no library, no request.
// Each element of class "space" holds its scene as JSON, packed by _space.py, and its switches, made by _turning.py.
const TURN = 0.007, STEP = Math.PI / 36; // rad a px dragged, rad a key pressed
const LAP = 15; // s: the path is played in this time
const ASK = "Click on the picture: what is there is said here.", NOTHING = "Nothing is there.";

class Scene {
  constructor(root) {
    Object.assign(this, { root, form: root.querySelector("form"), canvas: root.querySelector("canvas"), now: 0 });
    root.querySelector(".idle").hidden = true;
    const gl = this.canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true, alpha: false });
    if (!gl) {
      root.querySelector(".without").hidden = false;
      return;
    }
    this.form.hidden = false;
    this.thumb = element("img", "", "thumb");
    this.thumb.hidden = true;
    this.canvas.after(this.thumb);
    this.model = new Model(new Packed(root.querySelector('script[type="application/json"]').textContent));
    this.camera = new Camera(this.model, this.canvas);
    this.drawing = new Drawing(gl, this.model);
    this.listen();
    this.listenToPointers();
    this.choose();
    this.stand(0);
  }

  on(name) { return Boolean(this.form.elements[name]?.checked); }

  // ---- drawing, when something has changed ----

  request() { this.asked ??= requestAnimationFrame(() => { this.asked = null; this.draw(); }); }

  draw() {
    const { canvas, camera } = this, sharp = Math.min(devicePixelRatio || 1, 2);
    if (this.drawing.gl.isContextLost() || !canvas.clientWidth) return;
    if (!this.isPlaced) camera.look("first", 0);
    this.isPlaced = true;
    for (const [side, length] of [["width", canvas.clientWidth], ["height", canvas.clientHeight]]) {
      const pixels = Math.max(1, Math.round(length * sharp));
      if (canvas[side] !== pixels) canvas[side] = pixels;
    }
    const ratio = sharp * clamp(canvas.clientWidth / 900, 0.65, 1); // lines are thinner in a small picture
    const card = getComputedStyle(canvas.parentElement).backgroundColor.match(/\d+/g);
    const paper = this.isPrinted || !card ? [255, 255, 255] : card.slice(0, 3).map(Number);
    this.drawing.draw(camera.matrix(), paper, ratio, (name) => this.on(name));
    this.drawRuler();
    canvas.dataset.draws = Number(canvas.dataset.draws || 0) + 1;
    canvas.dataset.drawn ??= Math.round(performance.now()); // ms from the page's start to the first picture
  }

  drawRuler() { // a length of 1, 2 or 5 times a power of ten, where the view turns about
    const size = this.camera.perPixel(), most = size * Math.min(130, 0.3 * this.canvas.clientWidth);
    const power = 10 ** Math.floor(Math.log10(most)), length = power * [5, 2, 1].find((k) => k * power <= most);
    const ruler = this.root.querySelector(".ruler");
    ruler.style.width = `${length / size}px`;
    const [times, unit] = length >= 1000 ? [0.001, "km"] : length >= 1 ? [1, "m"] : length >= 0.01 ? [100, "cm"] : [1000, "mm"];
    ruler.textContent = `${Number((length * times).toPrecision(2))} ${unit}`;
  }

  paint() {
    this.drawing.paint(this.layer, !this.on("ceiling"), this.isDark);
    this.request();
  }

  // ---- what people do ----

  listen() {
    const { canvas, form } = this;
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.drawing.load();
      this.paint();
      this.stand(this.now);
      this.say(null);
    });
    canvas.addEventListener("keydown", (event) => this.press(event));
    form.addEventListener("submit", (event) => event.preventDefault());
    form.addEventListener("change", (event) => { if (event.target.type !== "range") this.choose(event.target); });
    for (const button of form.querySelectorAll("[data-view]")) {
      button.addEventListener("click", () => { this.camera.look(button.dataset.view, this.now); this.request(); });
    }
    this.slider = form.querySelector('input[type="range"]');
    this.slider?.addEventListener("input", () => { this.play(false); this.stand(Number(this.slider.value)); this.tell(); });
    document.addEventListener("DOMContentLoaded", () => this.slider && this.showThumb(this.now)); // pictures come below
    document.addEventListener("shot", (event) => this.follow(event.detail));
    form.querySelector(".play")?.addEventListener("click", () => this.play(!this.timer));
    new ResizeObserver(() => this.request()).observe(canvas);
    const dark = matchMedia("(prefers-color-scheme: dark)");
    const dress = () => { this.isDark = dark.matches && !this.isPrinted; this.paint(); };
    this.isDark = dark.matches;
    dark.addEventListener("change", dress);
    addEventListener("beforeprint", () => { this.isPrinted = true; dress(); this.draw(); });
    addEventListener("afterprint", () => { this.isPrinted = false; dress(); });
  }

  listenToPointers() { // one turns, or moves with shift or another button; two move and zoom
    const { canvas, camera } = this, down = new Map();
    let moved = 0;
    const spread = () => {
      const [a, b] = [...down.values()];
      return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, size: Math.hypot(a.x - b.x, a.y - b.y) };
    };
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      camera.zoom(Math.exp(clamp(event.deltaY * (event.deltaMode ? 20 : 1), -150, 150) * 0.0015));
      this.request();
    }, { passive: false });
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
      moved += Math.abs(x) + Math.abs(y) + (before ? 99 : 0);
      if (before) {
        const after = spread();
        camera.zoom(before.size / Math.max(after.size, 1));
        camera.pan(after.x - before.x, after.y - before.y);
      } else if (event.shiftKey || event.buttons & 6) camera.pan(x, y);
      else camera.turn(-x * TURN, y * TURN);
      this.request();
    });
    const lift = (event) => {
      const isClick = down.delete(event.pointerId) && event.type === "pointerup" && moved < 6 && event.button === 0;
      if (isClick) this.click(event);
    };
    canvas.addEventListener("pointerup", lift);
    canvas.addEventListener("pointercancel", lift);
  }

  press(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const { camera } = this;
    const [x, y] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] ?? [0, 0];
    if ((x || y) && event.shiftKey) camera.pan(-40 * x, 40 * y);
    else if (x || y) camera.turn(x * STEP, y * STEP);
    else if (event.key === "+" || event.key === "=") camera.zoom(0.85);
    else if (event.key === "-" || event.key === "_") camera.zoom(1 / 0.85);
    else if (event.key === "0") camera.look("first", 0);
    else return;
    event.preventDefault();
    this.request();
  }

  choose(input = null) { // a switch was pressed; none at the start
    if (!input || input.name === "layer") {
      this.layer = this.model.layers[Number(new FormData(this.form).get("layer"))] ?? null;
      this.lend("edges", "edge");
      if (!this.model.count.face) this.lend("points", "vertex");
      this.say(null);
      this.name();
    } else if (this.lent === input.name) this.lent = null;
    this.root.querySelector(".legend").replaceChildren(...legend(this.model, this.layer, this.on("strokes")));
    if (!input || ["layer", "ceiling"].includes(input.name)) this.paint();
    this.request();
  }

  lend(name, level) { // shown with a layer of its level, and gone with it
    const box = this.form.elements[name], isAsked = this.layer?.level === level;
    if (!box || box.checked === isAsked || (!isAsked && this.lent !== name)) return;
    box.checked = isAsked;
    this.lent = isAsked ? name : null;
  }

  name() { // for those who do not see it
    const { count, numbers, isPath, meta } = this.model, what = { map: "The map", mesh: "The mesh", points: "The points" };
    const path = isPath ? `, the camera's path with ${numbers.length} places` : "";
    const by = this.layer ? `; coloured by: ${this.layer.label}` : "";
    this.canvas.setAttribute("aria-label", `${what[meta.what]} in space: ${count.vertex} vertices, ${count.edge} edges, `
      + `${count.face} faces${path}${by}. Arrow keys turn it, plus and minus zoom, 0 shows all.`);
  }

  click(event) {
    const box = this.canvas.getBoundingClientRect(), mouse = [event.clientX - box.left, event.clientY - box.top];
    const shown = { isSolid: this.on("surface"), isOpen: !this.on("ceiling") };
    this.say(pick(this.model, this.camera, this.layer?.level ?? "face", mouse, shown), NOTHING);
  }

  say(found, otherwise = ASK) { // in a line, and by a mark
    this.root.querySelector(".said").textContent = found ? sentence(this.model, this.layer, found) : otherwise;
    this.drawing.mark(found ? cornersOf(this.model, found) : []);
    this.request();
  }

  // ---- along the path ----

  stand(row) {
    this.now = row;
    this.drawing.stand(row);
    this.request();
    if (!this.slider) return;
    const { numbers, states } = this.model, words = `frame ${numbers[row]}, ${states[row]}`;
    this.slider.value = row;
    this.slider.setAttribute("aria-valuetext", words);
    this.form.querySelector(".time output").textContent = words;
    this.showThumb(row);
  }

  tell() { // the frames to page through, if the page has some
    document.dispatchEvent(new CustomEvent("station", { detail: this.model.numbers[this.now] }));
  }

  follow(number) { // go where a picture was taken that somebody looks at
    const row = this.model.numbers.indexOf(number);
    if (!this.slider || row < 0 || row === this.now) return;
    this.play(false);
    this.stand(row);
  }

  showThumb(row) { // the last picture at or before it that the page has
    const now = this.model.numbers[row], number = (img) => Number(img.dataset.frame);
    const before = [...document.querySelectorAll("img[data-frame]")].filter((img) => img.src && number(img) <= now);
    const found = before.reduce((best, img) => (best && number(best) >= number(img) ? best : img), null);
    this.thumb.hidden = !found;
    if (!found || this.thumb.src === found.src) return;
    this.thumb.src = found.src;
    this.thumb.alt = `Left image of frame ${number(found)}`;
  }

  play(isOn) {
    clearInterval(this.timer);
    this.timer = null;
    this.form.querySelector(".play").textContent = isOn ? "Pause" : "Play";
    this.form.querySelector(".time output").setAttribute("aria-live", isOn ? "off" : "polite");
    if (!isOn) return;
    const last = this.model.numbers.length - 1, pause = clamp(1000 * LAP / last, 40, 400);
    const stride = Math.max(1, Math.round(pause * last / (1000 * LAP)));
    if (this.now >= last) this.stand(0);
    this.timer = setInterval(() => {
      this.stand(Math.min(this.now + stride, last));
      if (this.now >= last) this.play(false);
    }, pause);
  }
}

for (const root of document.querySelectorAll(".space:not([data-on])")) {
  root.dataset.on = "";
  new Scene(root);
}
