// The points: which one is asked for, what is set, and the program that is told of it.
let state = null;
let byIndex = [];
let views = [];
let current = 0; // index of a point
let active = 0; // index of a view
let frame = 0;
let going = 0; // to which frame
let line = Promise.resolve(); // changes are told in order
let pending = 0;
let grip = null; // what the mouse holds
let nudged = null; // what the arrow keys move

const host = (id) => document.getElementById(id);
const isSet = (view, index) => views[view].points[index]?.[2] > 0;
const asked = () => state.points.filter((point) => !point.optional).map((point) => point.index);
const shown = () => views.filter((view) => !view.figure.hidden);

function complain(words) {
  host("alert").textContent = words;
  host("alert").hidden = !words;
}

function tell(words) { host("status").textContent = words; }

async function ask(name, body) {
  const told = body && { method: "POST", keepalive: true, headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
  let answer;
  try {
    answer = await fetch(name, told || {});
  } catch {
    throw new Error("jaxmocap annotate does not answer any more; nothing is saved until it is started again.");
  }
  const found = await answer.json();
  if (!answer.ok) throw new Error(found.error);
  return found;
}

// One after the other, so that what is shown in the end is what is on disk.
function change(name, body) {
  pending++;
  line = line.then(async () => {
    try {
      const found = await ask(name, body);
      complain("");
      pending--;
      if ("point" in found && found.frame !== frame) await go(found.frame);
      take(found);
      if ("point" in found) [active, current] = [found.camera, found.point];
      refresh();
    } catch (error) {
      pending--;
      complain(error.message);
      reload();
    }
  });
  return line;
}

const reload = async () => take(await ask(`frame?frame=${frame}`).catch(() => null));

function take(found) {
  if (!found) return;
  state.history = found.history;
  if (found.frame !== frame || pending || grip || nudged) return; // what is newer here is told next
  found.views.forEach((about, index) => Object.assign(views[index], about));
  for (const view of views) view.lines = found.lines.filter((one) => one.to === view.index);
  refresh();
}

function set(view, index, place) {
  views[view].points[index] = place ? [...place, 1] : [0, 0, 0];
  refresh();
  const words = place ? `set at ${place.map((value) => value.toFixed(1)).join(", ")}` : "taken away";
  tell(`${views[view].name}, ${byIndex[index].title}: ${words}; saved.`);
  return change("set", { camera: view, frame, point: index, place });
}

// Lines in the other views while a point is dragged: the newest question counts, one at a time.
let wanted = null;
let busy = false;
async function follow(view, place) {
  wanted = { view, place };
  if (busy || !state.calibrated) return;
  busy = true;
  while (wanted) {
    const { view: from, place: [x, y] } = wanted;
    wanted = null;
    const lines = await ask(`line?camera=${from}&frame=${frame}&x=${x}&y=${y}`).catch(() => []);
    for (const other of views) {
      other.lines = other.lines.filter((one) => one.from !== from || one.point !== current);
      other.lines.push(...lines.filter((one) => one.to === other.index).map((one) => ({ from, point: current, ...one })));
      other.draw();
    }
  }
  busy = false;
}

// After a point: the next in this view that is not set, then the next view's, then the next frame's.
async function onward() {
  const order = asked();
  const later = order.slice(order.indexOf(current) + 1).find((index) => !isSet(active, index));
  if (later !== undefined && order.includes(current)) return choose(later);
  const left = shown().filter((view) => view.index > active);
  for (const view of left) {
    const first = order.find((index) => !isSet(view.index, index));
    if (first !== undefined) { activate(view.index); return choose(first); }
  }
  const next = state.frames[state.frames.indexOf(frame) + 1];
  if (next === undefined || !state.frames.includes(frame)) {
    refresh();
    return tell("That was the last point of the last view. Look once more, or press Finish.");
  }
  await line;
  await go(next);
}

function step(by) {
  const order = state.points.map((point) => point.index);
  const at = order.indexOf(current) + by;
  if (at >= 0 && at < order.length) choose(order[at]);
}

function choose(index) {
  current = index;
  for (const view of views) view.cross = null;
  refresh();
}

function activate(view) {
  active = view;
  refresh();
}

async function go(to) {
  going = to;
  const pictures = shown().map((view) => picture(view.index, to));
  const [found] = await Promise.all([ask(`frame?frame=${to}`), ...pictures]);
  if (going !== to) return;
  frame = to;
  views.forEach((view) => view.load(to));
  active = (shown().find((view) => asked().some((index) => !(found.views[view.index].points[index][2] > 0))) || shown()[0]).index;
  take(found);
  const order = asked();
  choose(order.find((index) => !isSet(active, index)) ?? order[0]);
  const next = state.frames[state.frames.indexOf(to) + 1];
  if (next !== undefined) for (const view of shown()) picture(view.index, next);
}
