(() => {
  // Frames to page through: previews choose, buttons and arrow keys step; points and mesh are drawn over the image.
  const gallery = document.currentScript.closest(".gallery");
  const find = (name) => gallery.querySelector(name);
  const { frames, table } = JSON.parse(find(".frames").textContent);
  const colours = bytesOf(table);
  const previews = [...gallery.querySelectorAll(".previews button")];
  const stage = find(".stage"), large = find(".large"), canvas = find("canvas"), said = find(".said");
  const previous = find(".previous"), next = find(".next"), points = find(".points"), mesh = find(".mesh");
  const places = previews.map((button) => Number(button.querySelector("img").dataset.frame)); // in the sequence
  let shown = 0, width = 1, height = 1;

  function bytesOf(words) {
    return Uint8Array.from(atob(words), (letter) => letter.charCodeAt(0));
  }

  function unpack(words) {
    const bytes = bytesOf(words);
    let at = 0;
    const read = () => {
      let value = 0, shift = 0, byte;
      do {
        byte = bytes[at++];
        value |= (byte & 127) << shift;
        shift += 7;
      } while (byte & 128);
      return value;
    };
    const count = read(), spots = new Float32Array(2 * count), steps = new Uint8Array(count), edges = [];
    let u = 0;
    for (let k = 0; k < count; k++) {
      u += read();
      spots[2 * k] = u / 2;
      spots[2 * k + 1] = read() / 2;
      steps[k] = read();
      for (let left = read(); left > 0; left--) edges.push(k, k + read());
    }
    return { spots, steps, edges };
  }

  function draw() {
    const pen = canvas.getContext("2d"), scale = Math.max(1, Math.min(3, devicePixelRatio * large.clientWidth / width));
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
    const { spots, steps, edges } = unpack(frames[shown].drawing);
    pen.scale(scale, scale);
    if (mesh.checked) {
      pen.beginPath();
      for (let k = 0; k < edges.length; k += 2) {
        pen.moveTo(spots[2 * edges[k]], spots[2 * edges[k] + 1]);
        pen.lineTo(spots[2 * edges[k + 1]], spots[2 * edges[k + 1] + 1]);
      }
      pen.lineWidth = 0.5;
      pen.strokeStyle = "rgba(255, 255, 255, 0.6)";
      pen.stroke();
    }
    if (!points.checked) return;
    for (let k = 0; k < steps.length; k++) {
      const from = 3 * steps[k];
      pen.fillStyle = steps[k] ? `rgb(${colours[from]}, ${colours[from + 1]}, ${colours[from + 2]})` : "#92acc8";
      pen.fillRect(spots[2 * k] - 1, spots[2 * k + 1] - 1, 2, 2);
    }
  }

  function show(number, moves) {
    shown = Math.max(0, Math.min(frames.length - 1, number));
    const image = previews[shown].querySelector("img");
    [width, height] = ["width", "height"].map((name) => Number(image.getAttribute(name)));
    large.setAttribute("width", width);
    large.setAttribute("height", height);
    large.src = image.src;
    large.alt = frames[shown].alt;
    said.textContent = `${shown + 1} of ${frames.length}: ${frames[shown].words}`;
    previews.forEach((button, k) => {
      button.tabIndex = k === shown ? 0 : -1;
      if (k === shown) button.setAttribute("aria-current", "true");
      else button.removeAttribute("aria-current");
    });
    previous.setAttribute("aria-disabled", String(shown === 0));
    next.setAttribute("aria-disabled", String(shown === frames.length - 1));
    if (moves) {
      const strip = previews[shown].closest("ul");
      strip.scrollLeft = previews[shown].offsetLeft - strip.offsetLeft - (strip.clientWidth - previews[shown].offsetWidth) / 2;
    }
    draw();
  }

  function look(number, moves) { // somebody chose this one: what is turned in space goes there
    show(number, moves);
    document.dispatchEvent(new CustomEvent("shot", { detail: places[shown] }));
  }

  function step(by) {
    const isInStrip = previews.includes(document.activeElement);
    look(shown + by, true);
    if (isInStrip) previews[shown].focus({ preventScroll: true });
  }

  const keys = { ArrowLeft: () => step(-1), ArrowRight: () => step(1) };
  keys.Home = () => step(-frames.length);
  keys.End = () => step(frames.length);
  gallery.addEventListener("keydown", (event) => {
    if (event.target.type === "checkbox" || !(event.key in keys) || event.altKey || event.ctrlKey || event.metaKey) return;
    keys[event.key]();
    event.preventDefault();
  });
  previews.forEach((button, k) => button.addEventListener("click", () => look(k, false)));
  document.addEventListener("station", (event) => { // the last one taken until then
    const k = places.findLastIndex((place) => place <= event.detail);
    if (k >= 0 && k !== shown) show(k, true);
  });
  previous.addEventListener("click", () => step(-1));
  next.addEventListener("click", () => step(1));
  for (const box of [points, mesh]) box.addEventListener("change", draw);
  addEventListener("resize", draw);
  find(".bar").style.background = `linear-gradient(to right, ${[0, 64, 128, 192, 255]
    .map((k) => `rgb(${colours.slice(3 * k, 3 * k + 3).join(", ")})`).join(", ")})`;
  stage.hidden = false;
  gallery.classList.add("live");
  show(0, false);
})();
