// The page: upload by dropping, watch the stages, turn the mesh. Every picture is a plain GET of render.png.

const at = (id) => document.getElementById(id);
const view = at("view"), picture = at("picture"), outline = at("outline"), controls = at("controls");
const camera = { azimuth: 30, elevation: 20, zoom: 1 };
const NEAREST = 0.05, FARTHEST = 4;  // zoom, as a part of the fitted view's height
const FIT_MARGIN = 1.02;
let chosen = null;      // MeshInfo that is shown
let watching = null;    // EventSource of a mesh in work
let wanted = false, busy = false;

const api = async (path, options) => {
  const answer = await fetch(path, options);
  if (!answer.ok) {
    const problem = await answer.json().catch(() => ({}));
    throw new Error(problem.detail || problem.title || `The service answered ${answer.status}.`);
  }
  return answer;
};

const complain = (error) => {
  at("notice").textContent = error ? error.message : "";
  at("notice").hidden = !error;
};

const element = (tag, properties = {}, ...children) => {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
};

const count = (n) => n.toLocaleString("en");

// ---- the list ----

async function refresh() {
  const { meshes } = await (await api("/v1/meshes?limit=50")).json();
  at("meshes").replaceChildren(...meshes.map(row));
  markChosen();
  return meshes;
}

function row(mesh) {
  const thumb = mesh.links.thumbnail
    ? element("img", { className: "thumb", src: `${mesh.links.thumbnail}?size=104`, alt: "" })
    : element("span", { className: "thumb", textContent: mesh.status === "failed" ? "✕" : "…" });
  const about = mesh.stats ? `${count(mesh.stats.faces)} faces` : mesh.status;
  const title = element("span", { className: "title" }, element("b", { textContent: mesh.name, title: mesh.name }), element("small", { textContent: about }));
  const pick = element("button", { className: "pick", onclick: () => choose(mesh) }, thumb, title);
  const remove = element("button", { className: "remove", title: `Delete ${mesh.name}`, textContent: "✕", onclick: () => discard(mesh) });
  const item = element("li", { className: mesh.status }, pick, remove);
  item.dataset.id = mesh.id;
  return item;
}

function markChosen() {
  for (const item of at("meshes").children) item.classList.toggle("chosen", item.dataset.id === chosen?.id);
}

async function discard(mesh) {
  try {
    await api(mesh.links.self, { method: "DELETE" });
    if (chosen?.id === mesh.id) choose(null);
    await refresh();
  } catch (error) { complain(error); }
}

// ---- upload ----

function upload(file) {
  complain(null);
  const request = new XMLHttpRequest();  // fetch does not tell how much of a body has gone
  request.open("POST", `/v1/meshes?name=${encodeURIComponent(file.name)}`);
  request.upload.onprogress = (event) => showStages([{ name: "upload", status: "running", progress: event.loaded / event.total }]);
  request.onerror = () => complain(new Error("The upload did not reach the service."));
  request.onload = () => {
    const body = JSON.parse(request.responseText || "{}");
    if (request.status >= 300) { showStages([]); return complain(new Error(body.detail || body.title)); }
    choose(body);
    refresh();
  };
  request.send(file);
}

at("file").onchange = (event) => { if (event.target.files[0]) upload(event.target.files[0]); event.target.value = ""; };
for (const name of ["dragover", "dragleave", "drop"]) {
  document.addEventListener(name, (event) => {
    event.preventDefault();
    at("drop").classList.toggle("over", name === "dragover");
    if (name === "drop" && event.dataTransfer.files[0]) upload(event.dataTransfer.files[0]);
  });
}

// ---- one mesh ----

function choose(mesh) {
  chosen = mesh;
  watching?.close();
  const ready = mesh?.status === "ready";
  at("hint").hidden = !!mesh;
  for (const part of [picture, outline, at("save")]) part.hidden = true;
  describe(mesh);
  showStages(mesh && !ready ? mesh.stages : []);
  if (mesh?.error) complain(new Error(mesh.error.detail)); else complain(null);
  if (ready) draw();
  else if (mesh && mesh.status !== "failed") watch(mesh);
  markChosen();
}

function watch(mesh) {
  watching = new EventSource(mesh.links.events);
  watching.onmessage = (event) => {
    const info = JSON.parse(event.data);
    if (chosen?.id !== info.id) return;
    if (info.status === "ready" || info.status === "failed") { watching.close(); choose(info); refresh(); }
    else {
      if (info.status !== chosen.status) refresh();
      chosen = info;
      showStages(info.stages);
    }
  };
  watching.addEventListener("deleted", () => { watching.close(); choose(null); refresh(); });
}

function showStages(stages) {
  at("stages").hidden = !stages.length;
  at("stages").replaceChildren(...stages.map((stage) => element("li", { className: stage.status },
    element("span", { textContent: stage.name }),
    element("progress", { max: 1, value: stage.progress }),
    element("span", { textContent: stage.status === "done" && stage.seconds != null ? `${stage.seconds.toFixed(1)} s` : stage.status === "running" ? `${Math.round(stage.progress * 100)} %` : stage.status }))));
}

function describe(mesh) {
  at("name").textContent = mesh?.name ?? "\u00a0";
  const facts = [];
  if (mesh?.stats) {
    const { vertices, faces, edges, components, closed } = mesh.stats;
    facts.push(["faces", count(faces)], ["vertices", count(vertices)], ["edges", count(edges)], ["components", count(components)], ["closed", closed ? "yes" : "no"]);
  }
  if (mesh?.hull) facts.push(["hull faces", count(mesh.hull.faces)], ["hull excess", `${(mesh.hull.volume_excess * 100).toFixed(1)} %`]);
  for (const [name, { available, reason }] of Object.entries(mesh?.capabilities ?? {})) facts.push([name, available ? "yes" : reason ?? "no"]);
  at("facts").replaceChildren(...facts.flatMap(([key, value]) => [element("dt", { textContent: key }), element("dd", { textContent: value })]));
  const files = Object.entries(mesh?.links ?? {}).filter(([, href]) => href.includes("/artifacts/") || href.endsWith("silhouette.svg"));
  if (mesh?.links.accuracy) files.push(["what accuracy costs", `${mesh.links.accuracy}.svg`]);
  at("links").replaceChildren(...files.map(([name, href]) => element("a", { href, textContent: name })));
  at("drawn").hidden = mesh?.status !== "ready";
  at("timing").replaceChildren();
  at("accuracy").textContent = "";
}

// ---- pictures: one request at a time, always for the newest view ----

function query() {
  const box = view.getBoundingClientRect(), form = new FormData(controls);
  const fov = 2 * Math.atan(Math.tan(Math.PI / 8) * camera.zoom) * 180 / Math.PI;
  const size = { width: Math.round(box.width), height: Math.round(box.height) };
  return { azimuth: camera.azimuth.toFixed(2), elevation: camera.elevation.toFixed(2), fov: fov.toFixed(3), ...size, form };
}

async function draw() {
  wanted = true;
  if (busy || chosen?.status !== "ready") return;
  busy = true;
  try {
    while (wanted && chosen?.status === "ready") { wanted = false; await frame(chosen); }
  } catch (error) { complain(error); controls.turn.checked = false; }
  busy = false;
}

async function frame(mesh) {
  const { form, ...shared } = query();
  // a fitted distance would undo the zoom: the distance stays that of a 45 degree view of the bounding sphere
  const distance = orbitDistance(mesh, shared.width / shared.height);
  const place = new URLSearchParams({ ...shared, ...(distance ? { distance: distance.toPrecision(8) } : {}) });
  const look = new URLSearchParams({ source: form.get("source"), antialias: form.get("antialias"), shading: form.get("shading") });
  if (["msaa", "ssaa"].includes(look.get("antialias"))) look.set("source", "original");
  if (form.get("budget")) look.set("budget", form.get("budget"));
  const address = `/v1/meshes/${mesh.id}/render.png?${place}&${look}`;
  const lines = form.has("outline") ? api(`/v1/meshes/${mesh.id}/silhouette.svg?${place}`) : null;
  const start = performance.now();
  const answer = await api(address, { cache: "no-store" });  // a kept picture would come with old timings
  await show(picture, await answer.blob());
  const elapsed = performance.now() - start;
  outline.hidden = !lines;
  if (lines) await show(outline, await (await lines).blob());
  if (chosen?.id !== mesh.id) return;
  complain(null);
  tell(answer.headers, elapsed);
  Object.assign(at("save"), { href: address, hidden: false });
  if (controls.turn.checked) { camera.azimuth = (camera.azimuth + 2) % 360; wanted = true; }
}

function orbitDistance(mesh, aspect) {
  if (!mesh.sphere) return null;
  return mesh.sphere.radius * FIT_MARGIN / Math.sin(Math.atan(Math.min(1, aspect) * Math.tan(Math.PI / 8)));
}

async function show(image, blob) {
  const before = image.src;
  image.src = URL.createObjectURL(blob);
  await image.decode();
  image.hidden = false;
  if (before) URL.revokeObjectURL(before);
}

function tell(headers, elapsed) {
  const passes = (headers.get("Server-Timing") ?? "").split(",").map((part) => part.trim().match(/^(\S+?);dur=([\d.]+)/)).filter(Boolean).map(([, name, ms]) => [name, Number(ms)]);
  const most = Math.max(...passes.map(([, ms]) => ms), 0.001), total = passes.reduce((sum, [, ms]) => sum + ms, 0);
  const bar = ([name, ms], className = "") => {
    const length = element("i");
    length.style.width = `${Math.min(100, ms / most * 100)}%`;
    return element("div", { className }, element("span", { textContent: name }), className ? element("span") : length, element("span", { textContent: `${ms.toFixed(2)} ms` }));
  };
  const drawn = passes.length ? bar(["in all", total], "total") : element("p", { textContent: "Drawn before, and kept." });
  at("timing").replaceChildren(...passes.map((pass) => bar(pass)), drawn, bar(["round trip", elapsed], "trip"));
  at("accuracy").textContent = `${headers.get("X-Accuracy") ?? ""} · ${headers.get("X-Plan") ?? ""}`;
}

// ---- turning ----

let grip = null;
view.onpointerdown = (event) => { grip = [event.clientX, event.clientY]; view.setPointerCapture(event.pointerId); };
view.onpointerup = view.onpointercancel = () => { grip = null; };
view.onpointermove = (event) => {
  if (!grip) return;
  turn((grip[0] - event.clientX) * 0.4, (event.clientY - grip[1]) * 0.4);
  grip = [event.clientX, event.clientY];
};
view.onwheel = (event) => {
  event.preventDefault();
  camera.zoom = Math.min(FARTHEST, Math.max(NEAREST, camera.zoom * Math.exp(event.deltaY * 0.001)));
  draw();
};
view.onkeydown = (event) => {
  const step = { ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5] }[event.key];
  if (step) { event.preventDefault(); turn(...step); }
};
function turn(azimuth, elevation) {
  camera.azimuth = (camera.azimuth + azimuth + 360) % 360;
  camera.elevation = Math.max(-90, Math.min(90, camera.elevation + elevation));
  draw();
}
controls.onchange = draw;
controls.onsubmit = (event) => event.preventDefault();
new ResizeObserver(draw).observe(view);

refresh().then((meshes) => { if (meshes.length && !chosen) choose(meshes[0]); }, complain);
