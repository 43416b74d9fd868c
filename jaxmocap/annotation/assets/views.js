"use strict";
// Pictures with their points, one canvas per view: drawing, zoom, and from the screen to the video's pixels and back.
const COLOURS = { left: "#ff8a3c", right: "#2ee6c8", "": "#f5e663" };
const LINES = ["#ff5ad1", "#6db0ff", "#b6ff5c", "#ffb02e"];
const GRAB = 10; // screen pixels around a point

class View {
  constructor(index, about, host) {
    Object.assign(this, { index, name: about.name, size: about.size, numbers: about.numbers });
    this.points = [];
    this.people = 0;
    this.lines = [];
    this.cross = null; // where Enter sets a point, for those who use keys
    this.frame = -1;
    this.image = null;
    this.canvas = document.createElement("canvas");
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "application");
    this.caption = document.createElement("figcaption");
    this.figure = document.createElement("figure");
    this.figure.append(this.canvas, this.caption);
    host.append(this.figure);
    this.whole();
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  whole() { this.zoom = 1; this.centre = [this.size[0] / 2, this.size[1] / 2]; }

  // Screen pixels per pixel of the video.
  get scale() {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    return Math.max(Math.min(w / this.size[0], h / this.size[1]), 1e-6) * this.zoom;
  }

  toScreen([x, y]) {
    const s = this.scale;
    return [(x - this.centre[0]) * s + this.canvas.clientWidth / 2, (y - this.centre[1]) * s + this.canvas.clientHeight / 2];
  }

  toVideo([x, y]) {
    const s = this.scale;
    const place = [(x - this.canvas.clientWidth / 2) / s + this.centre[0], (y - this.canvas.clientHeight / 2) / s + this.centre[1]];
    return this.inside(place);
  }

  inside(place) { return place.map((value, axis) => Math.min(Math.max(value, 0), this.size[axis])); }

  // What is under `at` on the screen stays there.
  zoomBy(factor, at) {
    const fixed = this.toVideo(at);
    this.zoom = Math.min(Math.max(this.zoom * factor, 1), 40);
    if (this.zoom === 1) this.whole();
    else {
      const moved = this.toScreen(fixed);
      this.pan(at[0] - moved[0], at[1] - moved[1]);
    }
    this.draw();
  }

  pan(dx, dy) {
    if (this.zoom === 1) return;
    this.centre = this.inside([this.centre[0] - dx / this.scale, this.centre[1] - dy / this.scale]);
  }

  // Moves a zoomed picture so far that a place is seen.
  reveal(place) {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    const [x, y] = this.toScreen(place);
    const over = (value, most) => Math.min(value - 20, 0) + Math.max(value - most + 20, 0);
    this.pan(-over(x, w), -over(y, h));
  }

  nearest([x, y]) {
    let best = null;
    let least = GRAB;
    this.points.forEach((point, index) => {
      if (!(point[2] > 0)) return;
      const [a, b] = this.toScreen(point);
      const distance = Math.hypot(a - x, b - y);
      if (distance < least) [best, least] = [index, distance];
    });
    return best;
  }

  async load(frame) {
    if (this.frame === frame) return;
    this.frame = frame;
    const image = await picture(this.index, frame);
    if (this.frame !== frame) return;
    this.image = image;
    this.draw();
  }

  draw() {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: w, clientHeight: h } = this.canvas;
    this.canvas.width = Math.round(w * ratio);
    this.canvas.height = Math.round(h * ratio);
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    if (this.image) {
      const [left, top] = this.toScreen([0, 0]);
      pen.imageSmoothingEnabled = this.scale < 3;
      pen.drawImage(this.image, left, top, this.size[0] * this.scale, this.size[1] * this.scale);
    }
    this.drawLines(pen);
    this.drawBones(pen);
    this.points.forEach((point, index) => this.drawPoint(pen, point, index));
    if (this.cross) this.drawCross(pen);
  }

  path(pen, places) {
    pen.beginPath();
    places.forEach((place, number) => pen[number ? "lineTo" : "moveTo"](...this.toScreen(place)));
  }

  drawLines(pen) {
    for (const line of this.lines) {
      if (line.point !== current) continue;
      for (const [width, ink] of [[4, "rgba(0,0,0,.6)"], [2, LINES[line.from % LINES.length]]]) {
        this.path(pen, line.line);
        pen.setLineDash([9, 5]);
        pen.lineWidth = width;
        pen.strokeStyle = ink;
        pen.stroke();
      }
      pen.setLineDash([]);
    }
  }

  drawBones(pen) {
    for (const [a, b] of state.bones) {
      if (!(this.points[a]?.[2] > 0 && this.points[b]?.[2] > 0)) continue;
      const side = byIndex[a].side && byIndex[b].side ? byIndex[b].side : byIndex[b].side || byIndex[a].side;
      for (const [width, ink] of [[4, "rgba(0,0,0,.55)"], [2, COLOURS[side]]]) {
        this.path(pen, [this.points[a], this.points[b]]);
        pen.lineWidth = width;
        pen.strokeStyle = ink;
        pen.stroke();
      }
    }
  }

  // Full: set by hand. Hollow: a detector's, or worked out.
  drawPoint(pen, point, index) {
    if (!(point[2] > 0) || !byIndex[index]) return;
    const [x, y] = this.toScreen(point);
    const chosen = index === current && this.index === active;
    pen.beginPath();
    pen.arc(x, y, chosen ? 7 : 4.5, 0, 2 * Math.PI);
    pen.fillStyle = chosen || point[2] < 1 ? "rgba(0,0,0,.25)" : COLOURS[byIndex[index].side];
    pen.fill();
    for (const [width, ink] of [[3.5, "rgba(0,0,0,.7)"], [1.8, chosen ? "#fff" : COLOURS[byIndex[index].side]]]) {
      pen.lineWidth = width;
      pen.strokeStyle = ink;
      pen.stroke();
    }
    if (!chosen) return;
    pen.fillStyle = "#fff";
    pen.fillRect(x - 0.75, y - 0.75, 1.5, 1.5);
    this.write(pen, byIndex[index].title, x + 11, y - 9);
  }

  drawCross(pen) {
    const [x, y] = this.toScreen(this.cross);
    for (const [width, ink] of [[4, "#000"], [1.5, "#fff"]]) {
      pen.beginPath();
      for (const [a, b] of [[1, 0], [0, 1]]) {
        pen.moveTo(x - 12 * a, y - 12 * b);
        pen.lineTo(x + 12 * a, y + 12 * b);
      }
      pen.lineWidth = width;
      pen.strokeStyle = ink;
      pen.stroke();
    }
  }

  write(pen, words, x, y) {
    pen.font = "600 13px system-ui, sans-serif";
    pen.lineWidth = 4;
    pen.strokeStyle = "#000";
    pen.strokeText(words, x, y);
    pen.fillStyle = "#fff";
    pen.fillText(words, x, y);
  }
}

const kept = new Map();
function picture(camera, frame) {
  const address = `picture?camera=${camera}&frame=${frame}`;
  if (!kept.has(address)) {
    const image = new Image();
    image.src = address;
    kept.set(address, image.decode().then(() => image).catch(() => {
      kept.delete(address);
      complain(`The picture of frame ${frame} cannot be read.`);
      return null;
    }));
    if (kept.size > 12) kept.delete(kept.keys().next().value);
  }
  return kept.get(address);
}
