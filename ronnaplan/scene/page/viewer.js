// Draws the scene of this page with WebGL2: turned by the pointer or the arrow keys, each thing shown, faint or not.
(() => {
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const canvas = document.querySelector("canvas");
  const gl = canvas.getContext("webgl2", { antialias: true });
  if (!gl) return; // the still stays
  const VIEW = Math.tan((15 * Math.PI) / 180);
  const middle = scene.low.map((low, n) => low + scene.size[n] / 2);
  const reach = Math.hypot(...scene.size) / 2;
  const eye = { across: -0.7, up: 0.45, away: (0.78 * reach) / Math.sin(Math.atan(VIEW)) };

  const VERTEX = `#version 300 es
    uniform vec3 low, size, eye, middle; uniform mat3 axes; uniform vec2 lens; uniform vec2 range;
    in vec3 place, normal; out vec3 bright, towards;
    void main() {
      vec3 at = axes * (low + place * size - eye);
      bright = axes * normal; towards = -at;
      float depth = -at.z;
      gl_Position = vec4(at.xy * lens, ((range.x + range.y) * depth - 2.0 * range.x * range.y) / (range.y - range.x), depth);
    }`;
  const FRAGMENT = `#version 300 es
    precision highp float;
    uniform vec4 colour; in vec3 bright, towards; out vec4 shade;
    void main() {
      vec3 n = normalize(bright), v = normalize(towards);
      if (dot(n, v) < 0.0) n = -n;
      vec3 key = normalize(vec3(-0.5, 0.6, 0.9)), fill = normalize(vec3(0.9, 0.1, 0.5));
      float light = 0.2 + 0.72 * max(dot(n, key), 0.0) + 0.22 * max(dot(n, fill), 0.0);
      float gloss = 0.16 * pow(max(dot(n, normalize(key + v)), 0.0), 28.0);
      float veil = colour.a < 1.0 ? mix(colour.a, 1.0, 0.7 * pow(1.0 - dot(n, v), 2.0)) : 1.0;
      shade = vec4((colour.rgb * light + gloss) * veil, veil);
    }`;

  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return;
  gl.useProgram(program);
  const set = (name) => gl.getUniformLocation(program, name);

  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  function stored(target, data) {
    gl.bindBuffer(target, gl.createBuffer());
    gl.bufferData(target, data, gl.STATIC_DRAW);
    return data.byteLength;
  }
  function attribute(name, kind, stride) {
    const at = gl.getAttribLocation(program, name);
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, 3, kind, true, stride, 0);
  }
  for (const thing of scene.things) {
    thing.shape = gl.createVertexArray();
    gl.bindVertexArray(thing.shape);
    stored(gl.ARRAY_BUFFER, bytes(thing.places));
    attribute("place", gl.UNSIGNED_SHORT, 8);
    stored(gl.ARRAY_BUFFER, bytes(thing.normals));
    attribute("normal", gl.BYTE, 4);
    thing.count = stored(gl.ELEMENT_ARRAY_BUFFER, bytes(thing.triangles)) / 4;
    delete thing.places, delete thing.normals, delete thing.triangles;
    thing.shown = true;
  }

  function draw() {
    const ratio = window.devicePixelRatio;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(side * ratio)));
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const flat = Math.cos(eye.up);
    const back = [flat * Math.sin(eye.across), -flat * Math.cos(eye.across), Math.sin(eye.up)];
    const right = [Math.cos(eye.across), Math.sin(eye.across), 0];
    const top = [back[1] * right[2] - back[2] * right[1], back[2] * right[0] - back[0] * right[2], back[0] * right[1] - back[1] * right[0]];
    gl.viewport(0, 0, width, height);
    gl.clearColor(0.043, 0.055, 0.067, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniform3fv(set("low"), scene.low);
    gl.uniform3fv(set("size"), scene.size);
    gl.uniform3fv(set("eye"), middle.map((at, n) => at + eye.away * back[n]));
    gl.uniformMatrix3fv(set("axes"), true, [...right, ...top, ...back]);
    const shorter = Math.min(width, height);
    gl.uniform2f(set("lens"), shorter / width / VIEW, shorter / height / VIEW);
    gl.uniform2f(set("range"), Math.max(1, eye.away - 1.1 * reach), eye.away + 1.1 * reach);
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const clear = (thing) => thing.opacity < 1;
    const faces = (thing) => {
      gl.uniform4f(set("colour"), ...thing.colour, thing.opacity);
      gl.bindVertexArray(thing.shape);
      gl.drawElements(gl.TRIANGLES, thing.count, gl.UNSIGNED_INT, 0);
    };
    const shown = scene.things.filter((thing) => thing.shown && thing.opacity > 0);
    shown.filter((thing) => !clear(thing)).forEach(faces);
    for (const thing of shown.filter(clear)) { // depth first, so that only the nearest of its layers is blended
      gl.colorMask(false, false, false, false);
      gl.disable(gl.BLEND);
      faces(thing);
      gl.colorMask(true, true, true, true);
      gl.enable(gl.BLEND);
      gl.depthFunc(gl.LEQUAL);
      faces(thing);
      gl.depthFunc(gl.LESS);
      gl.disable(gl.BLEND);
    }
  }
  let asked = false;
  function redraw() {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => ((asked = false), draw()));
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
  canvas.addEventListener("wheel", (event) => (event.preventDefault(), nearer(Math.exp(-event.deltaY / 600))), { passive: false });
  const keys = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
  canvas.addEventListener("keydown", (event) => {
    if (keys[event.key]) turn(...keys[event.key]);
    else if (event.key === "+" || event.key === "-") nearer(event.key === "+" ? 1.1 : 1 / 1.1);
    else return;
    event.preventDefault();
  });

  const list = document.querySelector("fieldset");
  for (const thing of scene.things) {
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
  canvas.addEventListener("webglcontextlost", () => {
    canvas.hidden = list.hidden = true;
    document.getElementById("still").hidden = false;
  });
  canvas.hidden = list.hidden = false;
  document.getElementById("still").hidden = true;
  document.getElementById("how").textContent = "drag turns, wheel comes nearer \u00b7 ";
  new ResizeObserver(redraw).observe(canvas);
})();
