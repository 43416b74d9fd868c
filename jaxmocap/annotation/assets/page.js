// Buttons, keys and the mouse, and the start.
const FIGURE = {
  nose: [50, 18], neck: [50, 36], r_shoulder: [33, 39], r_elbow: [24, 66], r_wrist: [18, 92], l_shoulder: [67, 39],
  l_elbow: [76, 66], l_wrist: [82, 92], mid_hip: [50, 94], r_hip: [40, 95], r_knee: [37, 132], r_ankle: [35, 170],
  l_hip: [60, 95], l_knee: [63, 132], l_ankle: [65, 170], r_eye: [45, 13], l_eye: [55, 13], r_ear: [39, 16], l_ear: [61, 16],
  l_big_toe: [72, 182], l_heel: [62, 178], r_big_toe: [28, 182], r_heel: [38, 178],
};

function button(words, act, parent, attributes = {}) {
  const made = Object.assign(document.createElement("button"), { type: "button", textContent: words });
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.addEventListener("click", act);
  parent.append(made);
  return made;
}

function svg(name, attributes) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  host("mannequin").append(made);
  return made;
}

const marks = new Map();
function build() {
  views = state.views.map((about, index) => new View(index, about, host("views")));
  byIndex = [];
  for (const point of state.points) byIndex[point.index] = point;
  for (const [a, b] of state.bones) {
    const [[x1, y1], [x2, y2]] = [a, b].map((index) => FIGURE[byIndex[index].name]);
    svg("line", { x1, y1, x2, y2 });
  }
  for (const point of state.points) {
    const [cx, cy] = FIGURE[point.name];
    marks.set(point.index, {
      dot: svg("circle", { cx, cy, r: 3 }),
      button: button(point.title, () => choose(point.index), host("points"), { class: point.side || "wide" }),
    });
    if (point.optional) marks.get(point.index).button.classList.add("optional");
  }
  for (const view of views) {
    view.figure.hidden = !state.views[view.index].shown;
    if (views.length > 1) button(view.name, () => toggle(view), host("chosen"));
    listen(view);
  }
  host("number").max = state.num_frames - 1;
  showFrames();
  arrange();
}

function showFrames() {
  host("frames").replaceChildren();
  for (const number of state.frames) button(`frame ${number}`, () => goFrom(number), host("frames"));
}

function toggle(view) {
  if (shown().length === 1 && !view.figure.hidden) return;
  view.figure.hidden = !view.figure.hidden;
  if (views[active].figure.hidden) active = shown()[0].index;
  arrange();
  refresh();
}

// As many columns as let the pictures be largest, or nearly so: side by side rather than one above the other.
function arrange() {
  const some = shown();
  const { clientWidth: w, clientHeight: h } = host("views");
  const area = (columns) => {
    const rows = Math.ceil(some.length / columns);
    return Math.min(...some.map((v) => Math.min(w / columns / v.size[0], (h / rows - 24) / v.size[1]) * Math.sqrt(v.size[0] * v.size[1])));
  };
  let best = 1;
  for (let columns = 2; columns <= some.length; columns++) if (area(columns) > 0.85 * area(best)) best = columns;
  host("views").style.gridTemplateColumns = `repeat(${best}, minmax(0, 1fr))`;
}

function refresh() {
  if (!state || !views.length) return;
  const { title, hint } = byIndex[current];
  const done = isSet(active, current);
  host("wanted").textContent = `${views[active].name}: ${done ? "" : "click the "}${title}${done ? " (set)" : ""}`;
  const lines = views[active].lines.some((one) => one.point === current);
  host("hint").textContent = hint + (lines && !done ? "; on the dashed line" : "");
  for (const [index, mark] of marks) {
    mark.button.classList.toggle("set", Boolean(isSet(active, index)));
    mark.button.setAttribute("aria-pressed", String(index === current));
    mark.button.setAttribute("aria-label", `${byIndex[index].title}, ${isSet(active, index) ? "set" : "not set"}`);
    mark.dot.classList.toggle("here", index === current);
    mark.dot.setAttribute("r", index === current ? 6 : 3);
  }
  for (const view of views) {
    const count = asked().filter((index) => isSet(view.index, index)).length;
    view.caption.textContent = `${view.name}, frame ${view.numbers[frame]} of its video: ${count} of ${asked().length} points`;
    view.canvas.setAttribute("aria-label", `${view.caption.textContent}. Arrow keys move, Enter sets the point.`);
    view.figure.classList.toggle("active", view.index === active);
    view.draw();
  }
  [...host("chosen").children].forEach((one, index) => one.setAttribute("aria-pressed", String(!views[index].figure.hidden)));
  [...host("frames").children].forEach((one, index) => one.setAttribute("aria-pressed", String(state.frames[index] === frame)));
  host("number").value = frame;
  host("undo").disabled = !state.history[0];
  host("redo").disabled = !state.history[1];
  host("remove").disabled = !done;
  host("person").hidden = views[active].people < 2;
}

function listen(view) {
  const at = (event) => {
    const { left, top } = view.canvas.getBoundingClientRect();
    return [event.clientX - left, event.clientY - top];
  };
  view.canvas.addEventListener("focus", () => activate(view.index));
  view.canvas.addEventListener("pointerdown", (event) => {
    if (event.button > 1) return;
    view.canvas.focus({ preventScroll: true });
    view.canvas.setPointerCapture(event.pointerId);
    activate(view.index);
    view.cross = null;
    const near = event.button === 0 ? view.nearest(at(event)) : null;
    grip = { start: at(event), last: at(event), near, moved: false, pan: event.button === 1 };
    if (event.button === 1) event.preventDefault();
  });
  view.canvas.addEventListener("pointermove", (event) => {
    if (!grip) return;
    const [x, y] = at(event);
    if (!grip.moved && Math.hypot(x - grip.start[0], y - grip.start[1]) < 4) return;
    if (!grip.moved && grip.near !== null) {
      choose(grip.near);
      const [px, py] = view.toScreen(view.points[grip.near]);
      grip.off = [px - grip.start[0], py - grip.start[1]];
    }
    grip.moved = true;
    if (grip.near !== null) {
      grip.place = view.toVideo([x + grip.off[0], y + grip.off[1]]);
      view.points[grip.near] = [...grip.place, 1];
      follow(view.index, grip.place);
    } else view.pan(x - grip.last[0], y - grip.last[1]);
    grip.last = [x, y];
    view.draw();
  });
  view.canvas.addEventListener("pointerup", (event) => {
    const held = grip;
    grip = null;
    if (!held || held.pan) return;
    if (held.moved && held.near !== null) set(view.index, held.near, held.place);
    else if (!held.moved && held.near !== null && isSet(view.index, current)) choose(held.near);
    else if (!held.moved) place(view, view.toVideo(at(event)));
  });
  view.canvas.addEventListener("pointercancel", () => { grip = null; reload(); });
  view.canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    view.zoomBy(Math.exp(-Math.sign(event.deltaY) * Math.min(Math.abs(event.deltaY), 100) / 300), at(event));
  }, { passive: false });
}

function place(view, where) {
  const isNew = !isSet(view.index, current);
  set(view.index, current, where);
  if (isNew) onward().catch(failed);
}

// Arrow keys: a point that is set moves, else a cross does, and Enter sets the point there. A run of them is one change.
function keyInView(event, view) {
  const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (by) {
    event.preventDefault();
    const size = event.shiftKey ? 10 : 1;
    const done = isSet(view.index, current);
    const from = done ? view.points[current] : view.cross || [...view.centre];
    const to = view.inside([from[0] + size * by[0], from[1] + size * by[1]]);
    if (!done) {
      view.cross = to;
      tell(`${view.name}: ${to.map((value) => value.toFixed(0)).join(", ")}`);
    } else {
      view.points[current] = [...to, 1];
      follow(view.index, to);
      flush(view.index, current);
      nudged = { view: view.index, index: current, timer: setTimeout(flush, 250) };
    }
    view.reveal(to);
    view.draw();
  } else if (event.key === "Enter" && !event.target.closest("button, summary") && !isSet(view.index, current)) {
    event.preventDefault();
    place(view, view.cross || [...view.centre]);
  }
}

function flush(view, index) {
  if (!nudged) return;
  clearTimeout(nudged.timer);
  const { view: of, index: point } = nudged;
  nudged = null;
  if (of !== view || point !== index) set(of, point, views[of].points[point].slice(0, 2));
}

function failed(error) { complain(error.message); }

// What the arrow keys have moved is told of its own frame before another is shown.
function goFrom(to) { flush(); line.then(() => go(to)).catch(failed); }

function otherFrame(by) {
  const at = state.frames.indexOf(frame) + by;
  if (at >= 0 && at < state.frames.length) goFrom(state.frames[at]);
}

function zoom(factor) {
  const view = views[active];
  const { clientWidth: w, clientHeight: h } = view.canvas;
  view.zoomBy(factor, isSet(active, current) ? view.toScreen(view.points[current]) : view.cross ? view.toScreen(view.cross) : [w / 2, h / 2]);
}

const redo = () => { flush(); if (state.history[1]) change("redo", {}); };
const undo = () => { flush(); line.then(() => { if (state.history[0]) change("undo", {}); }); };
const remove = () => { flush(); if (isSet(active, current)) set(active, current, null); };
const KEYS = {
  n: () => onwardOrStep(), p: () => step(-1), Delete: remove, Backspace: remove, "+": () => zoom(1.5), "=": () => zoom(1.5),
  "-": () => zoom(1 / 1.5), 0: () => { views[active].whole(); views[active].draw(); }, PageDown: () => otherFrame(1),
  PageUp: () => otherFrame(-1),
};
function onwardOrStep() { if (isSet(active, current)) step(1); else onward().catch(failed); }

document.addEventListener("keydown", (event) => {
  if (event.target.closest("input")) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (event.ctrlKey || event.metaKey) {
    if (key !== "z" && key !== "y") return;
    event.preventDefault();
    if (key === "y" || event.shiftKey) redo(); else undo();
  } else if (!event.altKey && key in KEYS) { event.preventDefault(); KEYS[key](); }
  else if (!event.altKey) keyInView(event, views[active]);
});
host("undo").addEventListener("click", undo);
host("redo").addEventListener("click", redo);
host("remove").addEventListener("click", remove);
host("pass").addEventListener("click", onwardOrStep);
let person = 0;
host("person").addEventListener("click", () => {
  person = (person + 1) % views[active].people;
  change("person", { camera: active, frame, person });
});
host("other").addEventListener("submit", (event) => {
  event.preventDefault();
  const number = host("number").valueAsNumber;
  if (!(number >= 0 && number < state.num_frames)) return complain(`The capture has frames 0 to ${state.num_frames - 1}.`);
  complain("");
  if (!state.frames.includes(number)) {
    state.frames = [...state.frames, number].sort((a, b) => a - b);
    showFrames();
  }
  goFrom(number);
});
host("finish").addEventListener("click", async () => {
  flush();
  await line;
  try {
    const { written } = await ask("finish", {});
    tell(written.length ? `Saved: ${written.join(", ")}. This page may be closed.` : "Nothing was changed. This page may be closed.");
    for (const one of document.querySelectorAll("button, input")) one.disabled = true;
  } catch (error) { failed(error); }
});
window.addEventListener("resize", () => { arrange(); refresh(); });
window.addEventListener("pagehide", () => flush());

async function start() {
  state = await ask("state");
  build();
  await go(state.frames[0]);
  arrange();
  refresh();
}
start().catch(failed);
