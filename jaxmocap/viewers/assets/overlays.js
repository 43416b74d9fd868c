"use strict";
// The state of the page is one number: the position in the motion. `go` sets it, `listeners` are told.
const data = JSON.parse(document.getElementById("data").textContent);
const count = data.frames.length;
const listeners = [];
let here = 0;

function element(name, properties = {}, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

const COLOURS = { ok: "--ok", doubtful: "--doubtful", lost: "--lost", "passed over": "--passed" };
const classOf = (status) => status.replace(" ", "-");

function go(position) {
  here = Math.max(0, Math.min(count - 1, Math.round(position)));
  for (const listener of listeners) listener(here);
}

function goToFrame(frame) {
  const position = data.frames.indexOf(frame);
  if (position >= 0) go(position);
}

// The picture at a position is the last one at or before it: long captures have one for every few frames.
function pictureAt(position) {
  let low = 0;
  while (low + 1 < data.positions.length && data.positions[low + 1] <= position) low++;
  return low;
}

function buildOverlays() {
  if (!data.views.length) {
    document.getElementById("sheet-section").hidden = true;
    document.querySelector("#overlays .keys").textContent = "Arrow keys step through the curves below.";
    return;
  }
  const stage = document.getElementById("stage");
  const chooser = document.getElementById("views");
  const images = data.views.map((name) => {
    const image = element("img", { alt: `Overlay of ${name}` });
    stage.append(element("figure", {}, image, element("figcaption", { textContent: name })));
    return image;
  });
  const names = data.views.length > 1 ? ["all views", ...data.views] : data.views;
  const buttons = names.map((name, index) => {
    const button = element("button", { type: "button", textContent: name });
    button.addEventListener("click", () => choose(index));
    chooser.append(button);
    return button;
  });
  function choose(index) {
    const all = data.views.length > 1 && index === 0;
    const view = data.views.length > 1 ? index - 1 : 0;
    buttons.forEach((button, number) => button.setAttribute("aria-pressed", String(number === index)));
    [...stage.children].forEach((figure, number) => { figure.hidden = !all && number !== view; });
    stage.className = all ? "many" : "one";
    buildSheet(Math.max(view, 0));
  }
  chooseView = (index) => { if (index < buttons.length) choose(index); };
  listeners.push((position) => {
    const number = pictureAt(position);
    images.forEach((image, view) => { image.src = data.pictures[view][number]; });
  });
  choose(0);
}
let chooseView = () => {};

function buildSheet(view) {
  const sheet = document.getElementById("sheet");
  const shown = data.positions.length;
  const wanted = Math.min(shown, 12);
  const picks = new Set();
  for (let i = 0; i < wanted; i++) picks.add(wanted > 1 ? Math.round(i * (shown - 1) / (wanted - 1)) : 0);
  sheet.replaceChildren(...[...picks].map((number) => {
    const position = data.positions[number];
    const status = data.status[position];
    const image = element("img", { src: data.pictures[view][number], alt: "", loading: "lazy" });
    const label = status === "ok" ? `${data.frames[position]}` : `${data.frames[position]} ${status}`;
    const button = element("button", { type: "button", className: classOf(status) }, image,
      element("span", { textContent: `frame ${label}` }));
    button.addEventListener("click", () => { go(position); document.getElementById("overlays").scrollIntoView(); });
    return button;
  }));
}

let timer = null;
function play(on) {
  if (timer !== null) clearTimeout(timer);
  timer = null;
  const button = document.getElementById("play");
  button.textContent = on ? "\u275A\u275A" : "\u25B6";
  button.setAttribute("aria-label", on ? "Pause" : "Play");
  if (!on) return;
  const step = () => {
    const next = here + 1 < count ? here + 1 : 0;
    const wait = next ? (data.seconds[next] - data.seconds[here]) * 1000 : 600;
    timer = setTimeout(() => { go(next); step(); }, Math.min(Math.max(wait, 8), 2000));
  };
  step();
}

function jump(direction) {
  for (let position = here + direction; position >= 0 && position < count; position += direction) {
    if (data.status[position] !== "ok") return go(position);
  }
}

function buildBar() {
  const slider = document.getElementById("slider");
  const where = document.getElementById("where");
  slider.max = count - 1;
  slider.addEventListener("input", () => { play(false); go(slider.valueAsNumber); });
  document.getElementById("play").addEventListener("click", () => play(timer === null));
  listeners.push((position) => {
    slider.value = position;
    const words = `frame ${data.frames[position]}, ${data.seconds[position].toFixed(2)} s`;
    slider.setAttribute("aria-valuetext", `${words}, ${data.status[position]}`);
    const status = element("b", { textContent: data.status[position] });
    status.style.color = `var(${COLOURS[data.status[position]]})`;
    where.replaceChildren(words, element("br"), status);
  });
  document.addEventListener("click", (event) => {
    if (event.detail > 0) event.target.closest("button")?.blur(); // after a mouse's click, space plays
    const button = event.target.closest("button[data-frame]");
    if (button) { play(false); goToFrame(Number(button.dataset.frame)); document.getElementById("overlays").scrollIntoView(); }
  });
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select")) return;
    const big = event.shiftKey ? 10 : 1;
    const keys = {
      ArrowLeft: () => go(here - big), ArrowRight: () => go(here + big), Home: () => go(0), End: () => go(count - 1),
      n: () => jump(1), p: () => jump(-1),
    };
    if (event.key === " " && event.target.closest("button")) return;
    if (event.key === " ") { event.preventDefault(); play(timer === null); return; }
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (key in keys) { event.preventDefault(); play(false); keys[key](); }
    else if (/^[0-9]$/.test(key)) chooseView(Number(key));
  });
}

function paintStrip() {
  const strip = document.getElementById("strip");
  strip.width = count;
  strip.height = 1;
  const context = strip.getContext("2d");
  data.status.forEach((status, position) => {
    context.fillStyle = colour(COLOURS[status]);
    context.fillRect(position, 0, 1, 1);
  });
}
