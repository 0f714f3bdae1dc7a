// The page of a scene: turned by the pointer or the arrow keys, each thing shown, faint or not.
(() => {
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const canvas = document.querySelector("canvas");
  const viewer = window.ronnaplanViewer(canvas);
  if (!viewer) return; // the still stays
  const { middle, back, away } = scene.eye; // as the still is seen
  const reach = Math.hypot(...scene.size) / 2 + Math.hypot(...middle.map((at, n) => at - scene.low[n] - scene.size[n] / 2));
  const eye = { across: Math.atan2(back[0], -back[1]), up: Math.asin(back[2]), away };
  viewer.reach = reach;
  viewer.things = scene.things.map(viewer.load);
  // Which side of the patient is where: seen through, a head looks alike from both sides.
  const SIDES = { L: [1, 0, 0], R: [-1, 0, 0], P: [0, 1, 0], A: [0, -1, 0], S: [0, 0, 1], I: [0, 0, -1] }, BESIDE = 0.55;
  const head = scene.things.find((thing) => ["skin", "skull"].includes(thing.name)) ?? scene;
  const at = (way) => way.map((share, n) => head.low[n] + (0.5 + BESIDE * share) * head.size[n]);
  const sides = Object.entries(SIDES).map(([label, way]) => ({ label, labelAt: at(way), shown: true, kind: "side" }));
  const named = [...sides, ...viewer.things.filter((thing) => thing.label)];
  for (const thing of named) {
    thing.written = document.getElementById("names").appendChild(document.createElement("span"));
    thing.written.className = thing.kind ?? "";
    thing.written.dir = "auto"; // a name from right to left is shortened at its left
  }
  const pen = document.createElement("canvas").getContext("2d");
  let room = 0;
  function shorten() {
    room = canvas.clientWidth;
    for (const { written, label } of named) {
      pen.font = getComputedStyle(written).font;
      written.textContent = window.ronnaplanShortened(label, (text) => pen.measureText(text).width <= room / 2);
    }
  }

  function redraw() {
    const flat = Math.cos(eye.up);
    const back = [flat * Math.sin(eye.across), -flat * Math.cos(eye.across), Math.sin(eye.up)];
    const right = [Math.cos(eye.across), Math.sin(eye.across), 0];
    const top = [back[1] * right[2] - back[2] * right[1], back[2] * right[0] - back[0] * right[2], back[0] * right[1] - back[1] * right[0]];
    const position = middle.map((at, n) => at + eye.away * back[n]);
    viewer.eye = { position, axes: [...right, ...top, ...back], away: eye.away };
    viewer.redraw();
    if (room !== canvas.clientWidth) shorten();
    const beside = window.ronnaplanNames(canvas);
    for (const thing of named) {
      const [across, down, away] = viewer.onScreen(thing.labelAt);
      thing.written.hidden = !thing.shown;
      if (!thing.shown) continue;
      const place = beside(thing.written.offsetWidth, across, down), [left, top] = place ?? [0, 0];
      const visibility = place ? "" : "hidden", opacity = away > eye.away ? 0.45 : 1;
      Object.assign(thing.written.style, { left: `${left}px`, top: `${top}px`, visibility, opacity });
    }
  }
  function turn(across, up) {
    eye.across -= across;
    eye.up = Math.min(1.4, Math.max(-1.4, eye.up + up));
    redraw();
  }
  function nearer(factor) {
    eye.away = Math.min(8 * reach, Math.max(1.02 * reach, eye.away / factor));
    redraw();
  }

  const held = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, event);
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = held.get(event.pointerId);
    if (!last) return;
    const others = [...held.values()].filter((one) => one.pointerId !== event.pointerId);
    const away = (one) => Math.hypot(one.clientX - others[0].clientX, one.clientY - others[0].clientY);
    if (others.length) nearer(away(event) / Math.max(1, away(last)));
    else turn((event.clientX - last.clientX) / 150, (event.clientY - last.clientY) / 150);
    held.set(event.pointerId, event);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => held.delete(event.pointerId));
  canvas.addEventListener("wheel", (event) => {
    // in a page that the wheel scrolls, the view takes it only once it was clicked
    if (document.documentElement.scrollHeight > window.innerHeight && document.activeElement !== canvas) return;
    event.preventDefault();
    nearer(Math.exp(-event.deltaY / 600));
  }, { passive: false });
  const keys = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
  canvas.addEventListener("keydown", (event) => {
    if (keys[event.key]) turn(...keys[event.key]);
    else if (event.key === "+" || event.key === "-") nearer(event.key === "+" ? 1.1 : 1 / 1.1);
    else return;
    event.preventDefault();
  });

  const list = document.getElementById("shown");
  for (const thing of viewer.things) {
    const line = list.appendChild(document.createElement("label"));
    const box = line.appendChild(document.createElement("input"));
    Object.assign(box, { type: "checkbox", checked: true });
    box.addEventListener("change", () => ((thing.shown = box.checked), redraw()));
    const swatch = line.appendChild(document.createElement("i"));
    swatch.style.background = `rgb(${thing.colour.map((part) => Math.round(255 * part))})`;
    line.append(thing.name);
    if (!["skin", "skull"].includes(thing.name)) continue;
    const share = line.appendChild(document.createElement("input"));
    Object.assign(share, { type: "range", min: 0, max: 100, value: 100 * thing.opacity, ariaLabel: `opacity of ${thing.name}` });
    share.addEventListener("input", () => ((thing.opacity = share.value / 100), redraw()));
  }
  const how = document.getElementById("how"), ofStill = how.textContent;
  canvas.addEventListener("webglcontextlost", () => {
    how.textContent = ofStill;
    canvas.hidden = list.hidden = document.getElementById("names").hidden = true;
    document.getElementById("still").hidden = false;
  });
  canvas.hidden = list.hidden = false;
  document.getElementById("still").hidden = true;
  how.textContent = "drag turns, wheel comes nearer \u00b7 ";
  new ResizeObserver(redraw).observe(canvas);
})();
