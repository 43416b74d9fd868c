// The sections below the pictures, and the start.
const host = (id) => document.getElementById(id);

function words(summary, unit) {
  const parts = Object.entries(summary).map(([name, value]) => `${name} ${value.toFixed(2)} ${unit}`);
  return parts.length ? `${parts.join(", ")}.` : "";
}

function showAngles() {
  const chooser = host("dof");
  data.angles.forEach((angle, index) => {
    const note = angle.at_limit ? ` (at a limit in ${angle.at_limit} frame${angle.at_limit > 1 ? "s" : ""})` : "";
    chooser.append(element("option", { value: index, textContent: angle.name + note }));
  });
  const show = () => {
    const angle = data.angles[Number(chooser.value)];
    const lines = [{ value: angle.lower, name: `${angle.lower}\u00b0` }, { value: angle.upper, name: `${angle.upper}\u00b0` }];
    chart(host("angle"), { series: [{ name: `${angle.name}, degrees`, values: angle.values }], lines });
  };
  chooser.addEventListener("change", show);
  const elbow = data.angles.findIndex((angle) => angle.name === "l_elbow_flex");
  chooser.value = String(Math.max(elbow, 0));
  show();
}

// Terms have scales of their own, so each has a chart of its own.
function showEnergies() {
  const terms = Object.entries(data.energy);
  if (!terms.length) host("energy").append(element("p", { className: "hint", textContent: "Nothing was measured." }));
  terms.forEach(([name, values], index) => {
    const place = element("div");
    host("energy").append(place);
    chart(place, { series: [{ name, values, colour: index }], height: 95 });
  });
}

function showTimings() {
  const { stages, frames, whole } = data.timings;
  if (!stages.length && !Object.keys(whole).length) {
    host("timing-section").hidden = true;
    return;
  }
  host("timing-summary").textContent = Object.entries(whole).map(([name, value]) => `${name} ${value} s`).join(", ");
  const most = Math.max(...stages.map(([, value]) => value), 1e-9);
  const bars = element("div", { className: "bars" });
  for (const [stage, value] of stages) {
    const bar = element("i");
    bar.style.width = `${100 * value / most}%`;
    bars.append(element("span", { textContent: stage }), element("span", {}, bar),
      element("span", { textContent: `${value.toFixed(1)} s` }));
  }
  host("stages").append(bars);
  if (frames.length) chart(host("frame-seconds"), { series: [{ name: "seconds per frame", values: frames }] });
}

function showTables() {
  for (const { title, rows } of data.tables) {
    const table = element("table", {}, element("caption", { textContent: title }));
    for (const [name, value] of rows) {
      table.append(element("tr", {}, element("td", { textContent: name }), element("td", { textContent: value })));
    }
    host("tables").append(element("div", {}, table));
  }
}

buildOverlays();
buildBar();
paintStrip();
chart(host("confidence"), { series: [{ name: "mean over joints", values: data.confidence.mean }], range: [0, 1], height: 120 });
const paintHeat = heatMap(host("heat"), data.confidence.names, data.confidence.values);
host("uncertainty-section").hidden = !data.uncertainty;
if (data.uncertainty) {
  chart(host("uncertainty"), { series: Object.entries(data.uncertainty).map(([name, values]) => ({ name, values })) });
}
showEnergies();
showAngles();
const sides = ["left", "right"].map((name) => ({ name, values: data.skate[name], bars: data.skate.contact?.[name] }));
chart(host("skate"), { series: sides });
const contact = data.skate.contact;
host("skate-bars").textContent = !contact ? "Whether feet stand was not looked for."
  : Object.values(contact).flat().includes(1) ? "Bars: its heel or toe was found to stand, and was held."
    : "No heel or toe was found to stand.";
host("skate-summary").textContent = words(data.skate.summary, "m/s");
chart(host("jitter"), { series: [{ name: "mean over joints", values: data.jitter.values }] });
host("jitter-summary").textContent = words(data.jitter.summary, "m/s\u00b2");
showTimings();
showTables();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { paintStrip(); paintHeat(); });
go(0);
