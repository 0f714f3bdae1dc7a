// Draws things with WebGL2: for the page that `export --to html` writes, and for the planner. A thing is what packed.py
// makes of it. Whoever uses it owns the eye, the list of things and the events.
window.ronnaplanViewer = (canvas) => {
  const gl = canvas.getContext("webgl2", { antialias: true, stencil: true });
  if (!gl) return null;
  const HALF_VIEW = Math.tan((15 * Math.PI) / 180); // the picture's shorter side spans 30 degrees
  const NEAREST = 1, BACKGROUND = [0.043, 0.055, 0.067];

  const PROJECT = `
    uniform vec3 eye; uniform mat3 axes; uniform vec2 lens, range;
    vec4 seen(vec3 place) {
      vec3 at = axes * (place - eye);
      float depth = -at.z;
      return vec4(at.xy * lens, ((range.x + range.y) * depth - 2.0 * range.x * range.y) / (range.y - range.x), depth);
    }`;
  const BODY = [
    `#version 300 es
    ${PROJECT}
    uniform vec3 low, size;
    in vec3 place, normal; in vec4 paint; out vec3 bright, towards, world; out vec3 tint;
    void main() {
      world = low + place * size;
      bright = axes * normal; towards = -(axes * (world - eye)); tint = paint.rgb;
      gl_Position = seen(world);
    }`,
    `#version 300 es
    precision highp float;
    uniform vec4 colour, corner; uniform vec3 way; in vec3 bright, towards, world, tint; out vec4 shade;
    void main() {
      if (corner.w > 0.0 && all(greaterThan((world - corner.xyz) * way + 1.0 - abs(way), vec3(0.0)))) discard;
      vec3 n = normalize(bright), v = normalize(towards);
      if (dot(n, v) < 0.0) n = -n;
      vec3 key = normalize(vec3(-0.5, 0.6, 0.9)), fill = normalize(vec3(0.9, 0.1, 0.5));
      float light = 0.2 + 0.72 * max(dot(n, key), 0.0) + 0.22 * max(dot(n, fill), 0.0);
      float gloss = 0.16 * pow(max(dot(n, normalize(key + v)), 0.0), 28.0);
      float veil = colour.a < 1.0 ? mix(colour.a, 1.0, 0.7 * pow(1.0 - dot(n, v), 2.0)) : 1.0;
      shade = vec4((colour.rgb * tint * light + gloss) * veil, veil);
    }`,
  ];
  const CUT = [
    `#version 300 es
    ${PROJECT}
    uniform vec3 middle, right, down; out vec2 at; out vec3 world;
    void main() {
      vec2 corner = vec2(gl_VertexID % 2, gl_VertexID / 2) * 2.0 - 1.0;
      at = (corner + 1.0) / 2.0;
      world = middle + corner.x * right + corner.y * down;
      gl_Position = seen(world);
    }`,
    `#version 300 es
    precision highp float;
    uniform sampler2D picture; uniform vec4 corner; uniform vec3 way, across; in vec2 at; in vec3 world; out vec4 shade;
    void main() {
      // only the faces of the part that was taken away, a little over their edges: by rounding a pixel was on neither of two
      if (any(lessThan((world - corner.xyz) * way + across * 1e6, vec3(-0.1)))) discard;
      float grey = texture(picture, at).r;
      if (grey < 0.03) discard; // the air about the head
      shade = vec4(vec3(grey), 1.0);
    }`,
  ];

  function program([vertex, fragment]) {
    const made = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    ["place", "normal", "paint"].forEach((name, at) => gl.bindAttribLocation(made, at, name));
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
    const places = {};
    return { made, set: (name) => (places[name] ??= gl.getUniformLocation(made, name)) };
  }
  const body = program(BODY), cut = program(CUT), empty = gl.createVertexArray();

  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  function stored(thing, target, data) {
    const buffer = gl.createBuffer();
    thing.buffers.push(buffer);
    gl.bindBuffer(target, buffer);
    gl.bufferData(target, data, gl.STATIC_DRAW);
    return data.byteLength;
  }
  function attribute(at, count, kind, stride) {
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, count, kind, true, stride, 0);
  }

  // `whole` draws a scan among the bodies (volume.js), where there is one.
  const view = { things: [], planes: [], corner: null, way: [1, 1, 1], eye: null, reach: 1, whole: null, gl, program };

  view.load = (packed) => {
    const thing = { ...packed, buffers: [], shape: gl.createVertexArray(), shown: true };
    gl.bindVertexArray(thing.shape);
    stored(thing, gl.ARRAY_BUFFER, bytes(packed.places));
    attribute(0, 3, gl.UNSIGNED_SHORT, 8);
    stored(thing, gl.ARRAY_BUFFER, bytes(packed.normals));
    attribute(1, 3, gl.BYTE, 4);
    if (packed.paint) {
      stored(thing, gl.ARRAY_BUFFER, bytes(packed.paint));
      attribute(2, 4, gl.UNSIGNED_BYTE, 4);
    }
    thing.count = stored(thing, gl.ELEMENT_ARRAY_BUFFER, bytes(packed.triangles)) / 4;
    gl.bindVertexArray(null);
    for (const name of ["places", "normals", "paint", "triangles"]) delete thing[name];
    return thing;
  };
  view.forget = (thing) => {
    thing.buffers.forEach((buffer) => gl.deleteBuffer(buffer));
    gl.deleteVertexArray(thing.shape);
  };
  view.picture = (image, known) => {
    const texture = known ?? gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.LINEAR);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
    return texture;
  };

  view.onScreen = (place) => {
    // across and down in the canvas, and how far before the eye
    const { position, axes } = view.eye, { clientWidth: width, clientHeight: height } = canvas;
    const from = place.map((at, n) => at - position[n]);
    const [right, top, back] = [0, 3, 6].map((row) => from.reduce((sum, part, n) => sum + part * axes[row + n], 0));
    const scale = Math.min(width, height) / (2 * HALF_VIEW * -back);
    return [width / 2 + right * scale, height / 2 - top * scale, -back];
  };
  view.look = look;
  function look({ made, set }, width, height) {
    gl.useProgram(made);
    const { position, axes, away } = view.eye, shorter = Math.min(width, height);
    gl.uniform3fv(set("eye"), position);
    gl.uniformMatrix3fv(set("axes"), true, axes);
    gl.uniform2f(set("lens"), shorter / width / HALF_VIEW, shorter / height / HALF_VIEW);
    gl.uniform2f(set("range"), Math.max(NEAREST, away - 1.1 * view.reach), away + 1.1 * view.reach);
    gl.uniform4f(set("corner"), ...(view.corner ?? [0, 0, 0]), view.corner ? 1 : 0);
    gl.uniform3fv(set("way"), view.way);
  }
  function faces(thing, opacity = thing.opacity) {
    gl.uniform3fv(body.set("low"), thing.low);
    gl.uniform3fv(body.set("size"), thing.size);
    gl.uniform4f(body.set("colour"), ...thing.colour, opacity);
    gl.uniform4f(body.set("corner"), ...(view.corner ?? [0, 0, 0]), view.corner && thing.opens ? 1 : 0);
    gl.vertexAttrib4f(2, 1, 1, 1, 1);
    gl.bindVertexArray(thing.shape);
    gl.drawElements(gl.TRIANGLES, thing.count, gl.UNSIGNED_INT, 0);
  }
  function drawCuts(width, height) {
    look(cut, width, height);
    gl.bindVertexArray(empty);
    for (const plane of view.planes) {
      for (const name of ["middle", "right", "down", "across"]) gl.uniform3fv(cut.set(name), plane[name]);
      gl.bindTexture(gl.TEXTURE_2D, plane.texture);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    }
    look(body, width, height);
  }

  view.draw = () => {
    if (!view.eye || gl.isContextLost()) return;
    const ratio = window.devicePixelRatio;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(side * ratio)));
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    if (view.whole?.ready) view.whole.draw(width, height, () => drawBodies(width, height));
    else drawBodies(width, height);
  };
  // Depth first, so that of its layers only the nearest is blended, or the farthest.
  function layer(thing, before, orThere) {
    gl.depthFunc(before);
    gl.colorMask(false, false, false, false);
    faces(thing);
    gl.colorMask(true, true, true, true);
    gl.enable(gl.BLEND);
    gl.depthFunc(orThere);
    faces(thing);
    gl.disable(gl.BLEND);
    gl.depthFunc(gl.LESS);
  }
  // The far sides of what is seen through lie behind all that is in it; without them a head is as dark as the background.
  function farSides(things) {
    gl.clearDepth(0);
    for (const thing of things) {
      gl.clear(gl.DEPTH_BUFFER_BIT);
      layer(thing, gl.GREATER, gl.GEQUAL);
    }
    gl.clearDepth(1);
    gl.clear(gl.DEPTH_BUFFER_BIT);
  }
  function drawBodies(width, height) {
    gl.viewport(0, 0, width, height);
    gl.clearColor(...BACKGROUND, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    look(body, width, height);
    const shown = view.things.filter((thing) => thing.shown && thing.opacity > 0);
    const sheer = shown.filter((thing) => thing.opacity < 1);
    if (!view.screens) farSides([...sheer].reverse());
    gl.enable(gl.STENCIL_TEST); // 1 where something is seen: skin and skull are seen through only there
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.REPLACE);
    gl.stencilFunc(gl.ALWAYS, 1, 1);
    shown.filter((thing) => thing.opacity === 1).forEach((thing) => faces(thing));
    if (view.corner) drawCuts(width, height);
    for (const thing of sheer) {
      const screen = view.screens && thing.opens;
      gl.stencilFunc(screen ? gl.EQUAL : gl.ALWAYS, 1, 1);
      if (screen) {
        gl.stencilOp(gl.KEEP, gl.KEEP, gl.KEEP);
        gl.stencilFunc(gl.EQUAL, 0, 1);
        faces(thing, 1);
        gl.stencilFunc(gl.EQUAL, 1, 1);
      }
      layer(thing, gl.LESS, gl.LEQUAL);
      gl.stencilOp(gl.KEEP, gl.KEEP, gl.REPLACE);
    }
    gl.disable(gl.STENCIL_TEST);
  }
  let asked = false;
  view.redraw = () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => ((asked = false), view.draw()));
  };
  // Milliseconds that a frame takes: to read a pixel waits until it is drawn.
  view.timed = () => {
    const began = performance.now();
    view.draw();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    return performance.now() - began;
  };
  new ResizeObserver(view.redraw).observe(canvas);
  return view;
};
