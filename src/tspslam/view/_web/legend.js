// What colours, lines and dots are.
function legend(model, layer, isStroked) { // elements for the page
  const parts = [];
  if (layer) {
    if (layer.scale !== "rgb") parts.push((layer.scale === "phase" ? wheel : bar)(layer, model.tables[layer.scale]));
    const words = element("p"), isTold = layer.label.toLowerCase().includes(layer.unit);
    words.append(element("b", isTold ? `${layer.label}. ` : `${layer.label}, ${layer.unit}. `), layer.note);
    parts.push(words);
  }
  return [...parts, keys(model, layer, isStroked)];
}

function blend(table, count) { // stops of a gradient
  return Array.from({ length: count }, (_, k) => rgb(at(table, Math.round(255 * k / (count - 1))))).join(", ");
}

function bar(layer, table) {
  const made = element("div", "", "scale"), strip = element("i"), ticks = element("div");
  strip.style.background = `linear-gradient(to right, ${blend(table, 33)})`;
  let last = -1;
  for (const [share, words] of layer.ticks) {
    if (share - last < 0.11) continue; // they would overlap
    last = share;
    const tick = element("span", minus(words));
    tick.style.left = `${100 * share}%`;
    ticks.append(tick);
  }
  made.append(strip, ticks);
  return made;
}

function wheel(layer, table) { // as in the image: 0 points right, a quarter of a turn down
  const made = element("div", "", "wheel"), ring = element("i");
  ring.style.background = `conic-gradient(from 270deg, ${blend(table, 49)})`;
  made.append(ring);
  for (const [share, words] of layer.ticks.slice(1)) { // π is -π
    const angle = 2 * Math.PI * share - Math.PI, tick = element("span", words);
    tick.style.left = `${50 + 82 * Math.cos(angle)}%`;
    tick.style.top = `${50 + 76 * Math.sin(angle)}%`;
    made.append(tick);
  }
  return made;
}

function keys(model, layer, isStroked) {
  const list = element("ul", "", "keys");
  const add = (colour, words, name = "") => {
    const item = element("li"), sample = element("i", "", name);
    sample.style[name === "dot" ? "background" : "borderColor"] = rgb(colour);
    item.append(sample, words);
    list.append(item);
  };
  if (model.isPath) {
    add(PATH, "path and keyframes");
    add(NOW, "camera of the slider's frame");
    if (model.states.includes("weak")) add(WEAK, "few landmarks seen");
    if (model.states.includes("lost")) add(LOST, "lost");
    if (model.states.includes("loop")) add(LOOP, "loop closed", "dot");
  } else if (model.known.length) add(NOW, "camera");
  model.others.forEach(({ words }, k) => add(OTHERS[k % 3], words, "dashed"));
  if (isStroked) add(HEAD, "directions, from dark to bright: blue to yellow");
  if (!layer || layer.ok.includes(0)) add(model.meta.bare, "no value, clear", "dot");
  return list;
}
