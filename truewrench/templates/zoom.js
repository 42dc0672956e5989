"use strict";
let library = null;
function unpacked() {
  const packed = Uint8Array.from(atob(document.getElementById("bokeh").textContent.trim()), c => c.charCodeAt(0));
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
function coloured(text) {
  const dark = matchMedia("screen and (prefers-color-scheme: dark)").matches;
  return dark ? text.replace(/#[0-9a-f]{6}\b/gi, colour => DARK[colour.toLowerCase()] || colour) : text;
}
function hideOnClick(entry, models) {
  entry.addEventListener("click", () => {
    const hidden = entry.classList.toggle("hidden");
    for (const model of models) if (model.name === entry.dataset.label) model.visible = !hidden;
  });
}
async function zoom(button) {
  button.disabled = true;
  button.textContent = "drawing ...";
  await (library = library || loaded());
  const figure = JSON.parse(coloured(button.nextElementSibling.textContent));
  const legend = document.createElement("div");
  const place = document.createElement("div");
  legend.innerHTML = figure.legend;
  button.before(legend, place);
  await Bokeh.embed.embed_item(figure.item, place);
  const models = Bokeh.documents.at(-1).all_models;
  legend.querySelectorAll("[data-label]").forEach(entry => hideOnClick(entry, models));
  button.textContent = "Drag to zoom in, double-click to go back; more tools are right of the figure; press a name to hide it";
}
for (const button of document.querySelectorAll("button.zoom")) {
  if (typeof DecompressionStream === "function") button.hidden = false;
  button.addEventListener("click", () => zoom(button));
  if ("now" in button.dataset) button.click();
}
