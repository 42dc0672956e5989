"use strict";
(() => {
  const page = document.body.dataset.page;
  const place = (id) => document.getElementById(id);
  const chosen = { recordings: [], validate: [], rig: [], map: [], contact: [] };
  let sent = 0, requests = null, seen = 0, pressed = {};
  const scheme = window.matchMedia("(prefers-color-scheme: dark)");

  const ask = (request) => {
    if (requests === null) return;
    requests.data = { request: [JSON.stringify({ ...request, number: ++sent })] };
    if (["check", "scheme", "ready"].includes(request.do)) return;
    notice("");
    if (["view", "cell", "compare", "contact"].includes(request.do)) aged(true);
    busy(true, "working");
    document.body.dataset.busy = "true";
  };
  const aged = (are) => { for (const id of ["plots", "legend", "table"]) place(id).classList.toggle("old", are); };
  const notice = (html, wrong) => {
    const box = place("notice");
    place("notice-text").innerHTML = html; box.hidden = html === ""; box.classList.toggle("wrong", wrong === true);
  };
  const busy = (is, text) => {
    place("progress").classList.toggle("busy", is);
    place("cancel").hidden = !is;
    if (text !== undefined) place("progress-text").textContent = text;
    if (!is) { place("progress-text").textContent = "ready"; aged(false); }
  };
  const save = (file) => {
    const bytes = Uint8Array.from(atob(file.content), (c) => c.charCodeAt(0));
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([bytes], { type: file.kind }));
    link.download = file.name; link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  };
  const opened = () => {
    document.querySelector("main").classList.add("open");
    place("chooser").open = false;
  };
  const press = (view) => { for (const b of document.querySelectorAll("nav button")) b.setAttribute("aria-pressed", String(b.dataset.view === view)); };
  // What was pressed may be gone with the answer: the keyboard goes on at what took its place.
  const refocus = () => {
    if (document.activeElement !== document.body || !pressed.do) return;
    const same = `[data-do="${pressed.do === "add" ? "drop" : "undo"}"]`;
    const named = pressed.do === "add" ? `${same}[data-effect="${CSS.escape(pressed.effect)}"]` : same;
    (document.querySelector(named) || document.querySelector('[data-do="diagnose"]'))?.focus({ preventScroll: true });
    pressed = {};
  };
  const heard = (text) => {
    const answer = JSON.parse(text);
    if (answer.number <= seen) return;
    seen = answer.number;
    for (const [id, html] of Object.entries(answer.words || {})) {
      const where = place(id);
      if (where === null) continue;
      const focused = where.contains(document.activeElement) ? document.activeElement.getAttribute("aria-label") || document.activeElement.textContent : null;
      where.innerHTML = html;
      if (focused) [...where.querySelectorAll("button")].find((b) => (b.getAttribute("aria-label") || b.textContent) === focused)?.focus({ preventScroll: true });
      if (id === "view") press(where.querySelector("[data-shown]")?.dataset.shown || "");
      if (id === "reading") opened();
      if (id === "columns" && html) { place("chooser").open = true; where.scrollIntoView({ block: "start" }); }
      if (id === "view" && where.querySelector('[data-shown="trajectory"]')) place("trajectory").hidden = false;
      if (id === "reading") place("trajectory").hidden = true;
    }
    if (answer.words?.verdict) {
      (place("discovery") || place("verdict")).scrollIntoView({ block: "start" });
      place("discovery")?.querySelector("button").focus({ preventScroll: true });
      pressed = {};
    }
    if (answer.words && "steps" in answer.words) {
      if (pressed.do === "custom") place("steps").scrollIntoView({ block: "nearest" });
      refocus();
    }
    if (answer.words?.legend !== undefined || answer.notice !== undefined) aged(false);
    if (answer.notice !== undefined) notice(answer.notice, answer.wrong);
    if (answer.download) save(answer.download);
    if (answer.busy === false && answer.heard < sent) return;  // what was asked since is on its way
    if (answer.busy !== undefined) busy(answer.busy, answer.progress);
    else if (answer.progress !== undefined) busy(true, answer.progress);
    document.body.dataset.busy = place("progress").classList.contains("busy") ? "true" : "false";
  };

  // ---------------------------------------------------------------- what is clicked, typed and chosen
  const fields = (element) => {
    const form = element.closest("[data-form]"), found = {};
    if (form !== null)
      for (const field of form.querySelectorAll("input:not([type=file]), select, textarea"))
        if (field.name) found[field.name] = field.type === "checkbox" ? (field.checked ? "1" : "") : field.value;
    return found;
  };
  const steps = () => Math.max(document.querySelectorAll(".steps tbody tr").length - 1, 0);
  const act = (button) => {
    const { do: name, ...rest } = button.dataset;
    const request = { ...fields(button), ...rest, do: name };
    if ((["open", "puzzle"].includes(name) || (name === "pick" && !rest.only)) && steps() && (name !== "open" || chosen.recordings.length)
      && !confirm(`If this can be read, it replaces the study that is open, with its ${steps()} ${steps() > 1 ? "steps" : "step"}. Go on?`))
      return notice("Not opened; the study is as before.");
    pressed = { do: name, effect: rest.effect };
    if (name === "open") {
      Object.assign(request, { recordings: chosen.recordings, validate: chosen.validate, rig: chosen.rig.at(-1) || null, map: chosen.map.at(-1) || null });
      if (!chosen.recordings.length) return notice("<b>recording</b>: no file is chosen; choose one to fit", true);
    }
    if (name === "contact") request.recordings = chosen.contact.slice(-1);
    ask(request);
  };
  place("dismiss").addEventListener("click", () => notice(""));
  document.addEventListener("click", (event) => {
    const button = event.target instanceof Element ? event.target.closest("[data-do]") : null;
    if (button !== null && !button.disabled) act(button);
  });
  let waiting = 0;
  document.addEventListener("input", (event) => {
    const form = event.target instanceof Element ? event.target.closest("[data-check]") : null;
    if (form === null) return;
    clearTimeout(waiting);
    waiting = setTimeout(() => ask({ ...fields(event.target), do: form.dataset.check }), 200);
  });

  const uses = { recordings: "fit", validate: "held out", rig: "rig", map: "columns and units", contact: "contact" };
  const list = (use) => (use === "contact" ? place("contact-files") : place("files"));
  const forget = (line) => { const of = chosen[line.dataset.use]; if (line.dataset.file) of.splice(of.indexOf(line.dataset.file), 1); line.remove(); hint(); };
  const hint = () => { place("then").hidden = !place("files").children.length; };
  const choice = (line, name) => {
    const select = document.createElement("select");
    select.ariaLabel = `use of ${name}`;
    for (const use of Object.keys(uses).filter((u) => u !== "contact")) select.add(new Option(uses[use], use, false, use === line.dataset.use));
    select.addEventListener("change", () => {
      const of = chosen[line.dataset.use];
      of.splice(of.indexOf(line.dataset.file), 1);
      line.dataset.use = select.value; chosen[select.value].push(line.dataset.file);
    });
    return select;
  };
  const upload = async (file, use) => {
    const line = document.createElement("li"), words = document.createElement("span");
    words.textContent = `${file.name} (${uses[use]}): sending ...`;
    line.dataset.use = use; line.append(words); list(use).append(line); hint();
    const wrong = (text) => { words.textContent = `${file.name}: ${text}`; line.className = "wrong"; };
    const most = document.body.dataset.mostMegabytes;
    if (file.size > 1e6 * Number(most)) return wrong(`larger than ${most} MB`);
    try {
      const answer = await fetch("upload", { method: "POST", body: file, headers: { "X-Page": page, "X-Name": encodeURIComponent(file.name) } });
      const found = await answer.json();
      if (found.wrong) return wrong(found.wrong);
      chosen[use].push(found.file); line.dataset.file = found.file;
      words.textContent = use === "contact" ? `${found.name} (contact)` : `${found.name} `;
      if (use !== "contact") line.append(choice(line, found.name));
      const button = document.createElement("button");
      Object.assign(button, { type: "button", textContent: "Remove", ariaLabel: `remove ${found.name}` });
      button.addEventListener("click", () => forget(line)); line.append(" ", button);
    } catch { wrong("could not be sent"); }
  };
  document.addEventListener("change", async (event) => {
    if (!(event.target instanceof HTMLInputElement) || event.target.dataset.upload === undefined) return;
    const use = event.target.closest("#contact") ? "contact" : event.target.name;
    for (const line of [...list(use).children]) if (line.dataset.use === use) forget(line);
    const files = [...event.target.files];
    event.target.value = "";
    for (const file of files) await upload(file, use);
  });
  const drop = place("drop");
  for (const kind of ["dragover", "dragleave", "drop"]) drop.addEventListener(kind, (event) => { event.preventDefault(); drop.classList.toggle("over", kind === "dragover"); });
  drop.addEventListener("drop", async (event) => { for (const file of event.dataTransfer.files) await upload(file, file.name.endsWith(".toml") ? "rig" : "recordings"); });

  // The study goes with the page, a notebook's does not.
  addEventListener("beforeunload", (event) => { if (steps() && !place("chooser").hidden) event.preventDefault(); });

  // --------------------------------------------------------------------------------------- connection
  const model = (name) => window.Bokeh && Bokeh.documents.length ? Bokeh.documents[0].get_model_by_name(name) : null;
  const connect = () => {
    const answers = model("answers");
    if (!answers) return void setTimeout(connect, 20);
    answers.properties.data.change.connect(() => heard(answers.data.answer[0]));
    requests = model("requests");
    busy(false);
    document.body.dataset.ready = "true";
    ask({ do: "ready", dark: scheme.matches });
    Bokeh.documents[0].on_event("connection_lost", () => { busy(false, ""); place("progress-text").textContent = "not connected"; notice("<b>workbench</b>: the connection is lost; start it again and open the address that it prints", true); });
    scheme.addEventListener("change", () => ask({ do: "scheme", dark: scheme.matches }));
  };
  connect();
})();
