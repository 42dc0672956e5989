"use strict";
let library = null;
function unpacked() {
  const packed = Uint8Array.from(atob(document.getElementById("plotly").textContent.trim()), c => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).text();
}
async function loaded() {
  const script = document.createElement("script");
  script.src = URL.createObjectURL(new Blob([await unpacked()], { type: "text/javascript" }));
  const done = new Promise((resolve, reject) => { script.onload = resolve; script.onerror = reject; });
  document.head.append(script);
  return done;
}
async function zoom(button) {
  button.disabled = true;
  button.textContent = "drawing ...";
  await (library = library || loaded());
  const figure = JSON.parse(button.nextElementSibling.textContent);
  const place = document.createElement("div");
  const ink = getComputedStyle(document.body);
  const axis = { gridcolor: "rgba(128,128,128,0.25)", zerolinecolor: "rgba(128,128,128,0.5)" };
  for (const name of Object.keys(figure.layout).filter(n => /axis/.test(n))) {
    Object.assign(figure.layout[name], axis);
  }
  figure.layout.font = { color: ink.color, family: ink.fontFamily, size: 12 };
  button.before(place);
  const options = { responsive: true, displaylogo: false, scrollZoom: true };
  await Plotly.newPlot(place, figure.data, figure.layout, options);
  button.textContent = "Drag to zoom in, double-click to see all; drag along an axis to move";
}
for (const button of document.querySelectorAll("button.zoom")) {
  if (typeof DecompressionStream === "function") button.hidden = false;
  button.addEventListener("click", () => zoom(button));
}
