// Draws a whole scan with WebGL2 behind and before the bodies of a viewer (viewer.js): a ray through every pixel, with colour and
// opacity by a table. Whoever uses it owns the values and the table.
window.ronnaplanVolume = ({ gl, program, look }) => {
  const QUAD = `#version 300 es
    out vec2 at;
    void main() { at = vec2(gl_VertexID % 2, gl_VertexID / 2); gl_Position = vec4(2.0 * at - 1.0, 0.0, 1.0); }`;
  const CAST = [QUAD, `#version 300 es
    precision highp float; precision highp sampler3D;
    uniform sampler3D scan, greatest; uniform sampler2D table, depths;
    uniform vec3 eye, low, size, cells, blocks; uniform mat3 axes; uniform vec2 lens, range;
    uniform float least, stride; uniform vec4 corner; uniform vec3 way; in vec2 at; out vec4 shade;
    const float BLOCK = 8.0, OPAQUE = 0.985;
    const float FACE_MM = 0.1; // right behind a cut nothing is seen: by rounding a ray ends there, not at the cut
    vec3 ahead(vec3 ray) { return vec3(greaterThan(ray, vec3(0.0))); }
    float value(vec3 share) { return texture(scan, share).r; }
    bool taken(vec3 place) { return corner.w > 0.0 && all(greaterThan((place - corner.xyz) * way + 1.0 - abs(way), vec3(-FACE_MM))); }
    void main() {
      vec3 ray = vec3((2.0 * at - 1.0) / lens, -1.0) * axes; // as long as the eye sees a millimetre of depth
      float mm = length(ray);
      vec3 one = (low - eye) / ray, other = (low + size - eye) / ray, first = min(one, other), last = max(one, other);
      float far = min(min(last.x, last.y), last.z), t = max(max(max(first.x, first.y), first.z), range.x);
      float z = 2.0 * texture(depths, at).r - 1.0; // where the nearest body lies
      far = min(far, 2.0 * range.x * range.y / (range.x + range.y - z * (range.y - range.x)));
      float step = stride / mm;
      t += step * fract(sin(dot(gl_FragCoord.xy, vec2(12.9898, 78.233))) * 43758.5453); // or all rays would band alike
      vec3 cell = 1.0 / cells, key = normalize(vec3(-0.5, 0.6, 0.9)) * axes;
      vec4 sum = vec4(0.0);
      for (int n = 0; n < 2048 && t < far; n++, t += step) {
        vec3 place = eye + t * ray, share = (place - low) / size, block = floor(share * cells / BLOCK);
        if (texelFetch(greatest, ivec3(clamp(block, vec3(0.0), blocks - 1.0)), 0).r < least) {
          // nothing is seen in this block: go on where the ray leaves it
          vec3 end = low + (block + ahead(ray)) * BLOCK / cells * size;
          vec3 leave = (end - eye) / ray;
          t = max(t, floor((min(min(leave.x, leave.y), leave.z) - t) / step) * step + t);
          continue;
        }
        if (taken(place)) continue;
        vec4 seen = texture(table, vec2(value(share) * (255.0 / 256.0) + 0.5 / 256.0, 0.5));
        if (seen.a < 0.003) continue;
        vec3 slope = vec3(
          value(share + vec3(cell.x, 0, 0)) - value(share - vec3(cell.x, 0, 0)),
          value(share + vec3(0, cell.y, 0)) - value(share - vec3(0, cell.y, 0)),
          value(share + vec3(0, 0, cell.z)) - value(share - vec3(0, 0, cell.z)));
        float steep = length(slope);
        vec3 normal = steep > 1e-4 ? -slope / steep : key, towards = -ray / mm;
        if (dot(normal, towards) < 0.0) normal = -normal;
        float light = 0.2 + 0.6 * max(dot(normal, key), 0.0) + 0.14 * max(dot(normal, towards), 0.0);
        float gloss = 0.1 * pow(max(dot(normal, normalize(key + towards)), 0.0), 24.0);
        float share_seen = 1.0 - pow(1.0 - min(seen.a, 0.999), stride);
        sum += (1.0 - sum.a) * share_seen * vec4(seen.rgb * mix(1.0, light, clamp(steep * 12.0, 0.0, 1.0)) + gloss * min(1.0, steep * 8.0), 1.0);
        if (sum.a > OPAQUE) { sum /= sum.a; break; }
      }
      shade = sum;
    }`];
  const JOIN = [QUAD, `#version 300 es
    precision highp float; uniform sampler2D bodies, rays; in vec2 at; out vec4 shade;
    void main() {
      vec4 before = texture(rays, at);
      shade = vec4(before.rgb + (1.0 - before.a) * texture(bodies, at).rgb, 1.0);
    }`];
  const cast = program(CAST), join = program(JOIN), empty = gl.createVertexArray();
  const whole = { ready: false, share: 1, stride: 0.8 };
  const SCAN = 0, GREATEST = 1, TABLE = 2, DEPTHS = 3;

  function texture(kind, filter) {
    const made = gl.createTexture();
    gl.bindTexture(kind, made);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(kind, name, filter);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) gl.texParameteri(kind, name, gl.CLAMP_TO_EDGE);
    return made;
  }
  const scan = texture(gl.TEXTURE_3D, gl.LINEAR), greatest = texture(gl.TEXTURE_3D, gl.NEAREST), shades = texture(gl.TEXTURE_2D, gl.LINEAR);

  whole.load = (values, { cells, blocks, low, size }) => {
    Object.assign(whole, { cells, blocks, low, size, ready: true });
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    const count = cells[0] * cells[1] * cells[2];
    for (const [target, sides, part] of [[scan, cells, values.subarray(0, count)], [greatest, blocks, values.subarray(count)]]) {
      gl.bindTexture(gl.TEXTURE_3D, target);
      gl.texImage3D(gl.TEXTURE_3D, 0, gl.R8, ...sides, 0, gl.RED, gl.UNSIGNED_BYTE, part);
    }
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
  };
  whole.paint = (bytes, least) => {
    whole.least = least;
    gl.bindTexture(gl.TEXTURE_2D, shades);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
  };

  function target(width, height, deep) {
    const made = { width, height, frame: gl.createFramebuffer(), colour: texture(gl.TEXTURE_2D, gl.LINEAR) };
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, made.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, made.colour, 0);
    if (deep) {
      made.depth = texture(gl.TEXTURE_2D, gl.NEAREST);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.DEPTH_COMPONENT24, width, height, 0, gl.DEPTH_COMPONENT, gl.UNSIGNED_INT, null);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, made.depth, 0);
    }
    return made;
  }
  const targets = {};
  function sized(name, width, height, deep) {
    const known = targets[name];
    if (known?.width === width && known.height === height) return known;
    if (known) {
      gl.deleteFramebuffer(known.frame);
      for (const one of [known.colour, known.depth]) if (one) gl.deleteTexture(one);
    }
    return (targets[name] = target(width, height, deep));
  }
  function bound(unit, kind, one) {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(kind, one);
  }

  // Draws the bodies into a picture of their own, then casts rays up to them, then joins both.
  whole.draw = (width, height, drawBodies) => {
    const bodies = sized("bodies", width, height, true);
    gl.bindFramebuffer(gl.FRAMEBUFFER, bodies.frame);
    drawBodies();
    const [wide, high] = [width, height].map((side) => Math.max(1, Math.round(side * whole.share)));
    const rays = sized("rays", wide, high, false);
    gl.bindFramebuffer(gl.FRAMEBUFFER, rays.frame);
    gl.viewport(0, 0, wide, high);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    look(cast, width, height);
    for (const [unit, kind, one, name] of [
      [SCAN, gl.TEXTURE_3D, scan, "scan"], [GREATEST, gl.TEXTURE_3D, greatest, "greatest"],
      [TABLE, gl.TEXTURE_2D, shades, "table"], [DEPTHS, gl.TEXTURE_2D, bodies.depth, "depths"],
    ]) {
      bound(unit, kind, one);
      gl.uniform1i(cast.set(name), unit);
    }
    for (const name of ["low", "size", "cells", "blocks"]) gl.uniform3fv(cast.set(name), whole[name]);
    gl.uniform1f(cast.set("least"), whole.least - 1e-4);
    gl.uniform1f(cast.set("stride"), whole.stride / Math.max(whole.share, 0.5));
    gl.bindVertexArray(empty);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    gl.useProgram(join.made);
    bound(1, gl.TEXTURE_2D, rays.colour);
    bound(0, gl.TEXTURE_2D, bodies.colour);
    gl.uniform1i(join.set("bodies"), 0);
    gl.uniform1i(join.set("rays"), 1);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  };
  return whole;
};
