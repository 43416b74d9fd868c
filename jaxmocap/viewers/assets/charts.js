// Curves over time. All share the cursor; a gap in a curve is a value that was not computed.
const PALETTE = ["--c0", "--c1", "--c2", "--c3", "--c4", "--c5", "--c6"];
const MARGIN = { left: 42, right: 8, top: 6, bottom: 20 };
const BAR = 9;
const SVG = "http://www.w3.org/2000/svg";

function svg(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (parent) parent.append(made);
  return made;
}

function niceStep(span, about) {
  const raw = span / about;
  const power = 10 ** Math.floor(Math.log10(raw));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= raw);
}

function written(value, step) {
  return value.toFixed(Math.max(0, Math.min(4, -Math.floor(Math.log10(step)))));
}

function stroke(one, index) {
  return `var(${PALETTE[(one.colour ?? index) % PALETTE.length]})`;
}

// Runs of equal values: [value, first, last].
function runs(values) {
  const found = [];
  values.forEach((value, position) => {
    if (found.length && found.at(-1)[0] === value) found.at(-1)[2] = position;
    else found.push([value, position, position]);
  });
  return found;
}

const spans = runs(data.status).filter(([status]) => status !== "ok");

// `series`: [{name, values, colour, bars}], where `bars` is 1 in frames that a bar below the curves marks;
// `lines`: horizontal dashed lines [{value, name}], `range`: [low, high] or null.
function chart(host, { series, lines = [], range = null, height = 170 }) {
  const known = [...series.flatMap((one) => one.values), ...lines.map((line) => line.value)].filter((v) => v !== null);
  if (!known.length) {
    host.replaceChildren(element("p", { className: "hint", textContent: "Nothing was measured." }));
    return;
  }
  let low = range ? range[0] : Infinity;
  let high = range ? range[1] : -Infinity;
  if (!range) {
    for (const value of known) { low = Math.min(low, value); high = Math.max(high, value); }
    if (low > 0 && low < 0.6 * high) low = 0;
    if (high - low < 1e-9) { high += 0.5; low -= 0.5; }
    else { const room = 0.05 * (high - low); high += room; if (low !== 0) low -= room; }
  }
  const step = niceStep(high - low, height / 34);
  const root = svg("svg", { height, role: "img", "aria-label": series.map((one) => one.name).join(", ") });
  const legend = element("div", { className: "legend" });
  const readings = series.map((one, index) => {
    const swatch = element("i");
    swatch.style.background = stroke(one, index);
    const reading = element("span");
    legend.append(element("span", {}, swatch, `${one.name} `, reading));
    return reading;
  });
  const box = element("div", { className: "chart" }, root);
  host.replaceChildren(box, legend);
  let width = 0;
  let cursor = null;
  const x = (position) => MARGIN.left + (count > 1 ? position / (count - 1) : 0.5) * (width - MARGIN.left - MARGIN.right);
  const floor = height - MARGIN.bottom;
  const barred = series.filter((one) => one.bars);
  const y = (value) => MARGIN.top + (high - value) / (high - low) * (floor - BAR * barred.length - MARGIN.top);

  function draw() {
    width = box.clientWidth;
    if (!width) return;
    root.setAttribute("viewBox", `0 0 ${width} ${height}`);
    root.replaceChildren();
    for (const [status, first, last] of spans) {
      paintSpan(first, last, { y: MARGIN.top, height: floor - MARGIN.top, fill: `var(${COLOURS[status]})`, opacity: 0.25 });
    }
    for (let value = Math.ceil(low / step) * step; value <= high + 1e-9; value += step) {
      svg("line", { x1: MARGIN.left, x2: width - MARGIN.right, y1: y(value), y2: y(value), stroke: "var(--line)" }, root);
      const label = svg("text", { x: MARGIN.left - 5, y: y(value) + 4, "text-anchor": "end" }, root);
      label.textContent = written(value, step);
    }
    const every = Math.max(1, niceStep(Math.max(count - 1, 1), Math.max(2, Math.floor(width / 90))));
    for (let position = 0; position < count; position += every) {
      const label = svg("text", { x: x(position), y: height - 5, "text-anchor": "middle" }, root);
      label.textContent = data.frames[position];
    }
    for (const line of lines) {
      svg("line", { x1: MARGIN.left, x2: width - MARGIN.right, y1: y(line.value), y2: y(line.value),
        stroke: "var(--soft)", "stroke-dasharray": "5 4" }, root);
      svg("text", { x: width - MARGIN.right, y: y(line.value) + (line.value > (low + high) / 2 ? 13 : -4),
        "text-anchor": "end" }, root).textContent = line.name;
    }
    series.forEach((one, index) => paintCurve(one.values, stroke(one, index)));
    barred.forEach((one, row) => {
      const top = floor - BAR * (barred.length - row) + 2;
      for (const [, first, last] of runs(one.bars).filter(([stands]) => stands)) {
        paintSpan(first, last, { y: top, height: BAR - 3, fill: stroke(one, series.indexOf(one)), opacity: 0.6 });
      }
    });
    cursor = svg("line", { y1: MARGIN.top, y2: floor, stroke: "var(--ink)", "stroke-width": 1 }, root);
    move(here);
  }
  function paintSpan(first, last, attributes) {
    svg("rect", { x: x(first - 0.5), width: Math.max(x(last + 0.5) - x(first - 0.5), 2), ...attributes }, root);
  }
  function paintCurve(values, ink) {
    let path = "";
    values.forEach((value, position) => {
      if (value === null) return;
      const begins = position === 0 || values[position - 1] === null;
      path += `${begins ? "M" : "L"}${x(position).toFixed(1)} ${y(value).toFixed(1)}`;
      if (begins && (position + 1 === count || values[position + 1] === null)) path += "h0.01";
    });
    svg("path", { d: path, fill: "none", stroke: ink, "stroke-width": 1.7, "stroke-linejoin": "round",
      "stroke-linecap": "round" }, root);
  }
  function move(position) {
    series.forEach((one, index) => {
      const value = one.values[position];
      readings[index].textContent = value === null ? "\u2013" : String(value);
    });
    if (!cursor) return;
    cursor.setAttribute("x1", x(position));
    cursor.setAttribute("x2", x(position));
  }
  const follow = (event) => {
    const inside = event.clientX - box.getBoundingClientRect().left - MARGIN.left;
    play(false);
    go(inside / Math.max(width - MARGIN.left - MARGIN.right, 1) * (count - 1));
  };
  box.addEventListener("pointerdown", follow);
  box.addEventListener("pointermove", (event) => { if (event.buttons === 1) follow(event); });
  new ResizeObserver(draw).observe(box);
  if (host.moves) listeners.splice(listeners.indexOf(host.moves), 1);
  host.moves = move;
  listeners.push(move);
}

// Joints by frames; the stronger the colour, the less sure. The cells are painted once, the cursor at every step.
function heatMap(canvas, names, rows) {
  const line = 15;
  const left = 76;
  const cells = document.createElement("canvas");
  function paint() {
    const width = canvas.clientWidth;
    if (!width) return;
    const ratio = window.devicePixelRatio || 1;
    const height = names.length * line;
    canvas.style.height = `${height}px`;
    for (const sheet of [canvas, cells]) {
      sheet.width = width * ratio;
      sheet.height = height * ratio;
    }
    const context = cells.getContext("2d");
    context.scale(ratio, ratio);
    context.font = "11px system-ui, sans-serif";
    const step = (width - left - MARGIN.right) / count;
    rows.forEach((values, row) => {
      context.globalAlpha = 1;
      context.fillStyle = colour("--soft");
      context.fillText(names[row], 0, row * line + 11);
      context.fillStyle = colour("--c1");
      values.forEach((value, position) => {
        context.globalAlpha = 1 - value;
        context.fillRect(left + position * step, row * line + 1, step + 0.4, line - 2);
      });
    });
    move();
  }
  function move() {
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, canvas.width, canvas.height);
    if (cells.width) context.drawImage(cells, 0, 0);
    const ratio = window.devicePixelRatio || 1;
    const place = left + (here + 0.5) * (canvas.clientWidth - left - MARGIN.right) / count;
    context.fillStyle = colour("--ink");
    context.fillRect(place * ratio, 0, ratio, canvas.height);
  }
  canvas.addEventListener("pointerdown", (event) => {
    const inside = event.clientX - canvas.getBoundingClientRect().left - left;
    play(false);
    go(inside / Math.max(canvas.clientWidth - left - MARGIN.right, 1) * count - 0.5);
  });
  new ResizeObserver(paint).observe(canvas.parentElement);
  listeners.push(move);
  return paint;
}
