// The 3-D view, drawn here where there is WebGL2 that is quick enough; elsewhere the server is asked for pictures.
(() => {
  const SLOWEST_MS = 150, TIMED = 5; // a frame that takes longer is drawn sooner by the server
  const AT_ONCE = 50; // of hundreds of things one by one each would wait for the one before
  // What did not come is asked for again, as where the network changed meanwhile: soon at first, and ever more rarely.
  const ASK_AGAIN_MS = 1000, ASK_RARELY_MS = 30000;
  const things = new Map(), pictures = {};
  let viewer = null, slow = null, timed = [], loading = 0; // slow: a viewer that was found to be
  let askAgainMs = ASK_AGAIN_MS;

  function begin(canvas) {
    viewer = window.ronnaplanViewer(canvas);
    show(canvas);
    if (!viewer) return leave(canvas);
    viewer.screens = true;
    canvas.addEventListener("webglcontextlost", () => leave(canvas));
    window.addEventListener("click", (event) => event.target.closest?.("[data-again]") && again(canvas));
    window.trame.state.watch(["things"], (listed) => load(canvas, listed ?? []));
    window.trame.state.watch(["eye"], look);
    window.trame.state.watch(["volume"], whole);
    load(canvas, window.trame.state.get("things") ?? []);
    look(window.trame.state.get("eye"));
    whole(window.trame.state.get("volume"));
    window.ronnaplanPictures((name, drawn) => (viewer ?? slow) && ["axial", "coronal", "sagittal"].includes(name) && picture(name, drawn));
  }
  function show(canvas) {
    canvas.hidden = !viewer;
    canvas.closest(".rp-view").classList.toggle("rp-drawn-here", !!viewer);
    canvas.closest(".rp-view").classList.toggle("rp-slow", !!slow);
  }
  function leave(canvas, kept = null) {
    [viewer, slow] = [null, kept];
    show(canvas);
    window.trame.trigger("pictures");
  }
  // The machine may have been busy when it was timed: the reader may have it timed anew.
  async function again(canvas) {
    if (!slow) return;
    [viewer, slow, timed] = [slow, null, []];
    show(canvas);
    look(window.trame.state.get("eye"));
    await load(canvas, window.trame.state.get("things") ?? []);
    if (viewer) window.trame.trigger("drawn_here");
    else window.trame.state.set("news", `3-D still takes ${Math.round(Math.min(...timed))} ms a frame in this browser; the server draws it`);
  }

  // What an address answers, as it is read; null where no answer came, some time after that.
  async function fetched(address, read) {
    try {
      const answer = await fetch(address);
      if (answer.ok) {
        const content = await read(answer);
        askAgainMs = ASK_AGAIN_MS;
        return content;
      }
    } catch {} // asked again, as after an answer that is none
    const waitMs = askAgainMs;
    await new Promise((resolve) => setTimeout(resolve, waitMs));
    // once for all that failed together, and not where something came meanwhile
    if (askAgainMs === waitMs) askAgainMs = Math.min(2 * waitMs, ASK_RARELY_MS);
    return null;
  }
  async function load(canvas, listed) {
    if (!viewer) return;
    const turn = ++loading, lacking = listed.map((one) => one.key).filter((key) => !things.has(key));
    while (lacking.length) {
      // by their keys, without those that are shown no longer
      const come = await fetched(`things/${lacking.slice(0, AT_ONCE)}`, (answer) => answer.json());
      if (!viewer) return;
      for (const [key, one] of Object.entries(come ?? {})) if (!things.has(key)) things.set(key, viewer.load(one));
      if (come) lacking.splice(0, AT_ONCE);
      if (turn !== loading) return;
    }
    const keys = new Set(listed.map((one) => one.key));
    for (const [key, thing] of things) {
      if (!keys.has(key)) viewer.forget(thing), things.delete(key);
    }
    viewer.things = listed.map((one) => things.get(one.key)).filter(Boolean);
    if (timed.length < TIMED && viewer.things.length && viewer.eye) {
      timed = Array.from({ length: TIMED }, () => viewer.timed());
      if (Math.min(...timed) > SLOWEST_MS) return leave(canvas, viewer);
    }
    finely();
  }
  function look(eye) {
    if (!viewer || !eye?.position) return;
    Object.assign(viewer, { eye, reach: eye.reach, corner: eye.corner, way: eye.way });
    viewer.planes = eye.planes.filter((one) => pictures[one.view]).map((one) => ({ ...one, texture: pictures[one.view] }));
    finely();
  }
  function picture(name, drawn) {
    pictures[name] = (viewer ?? slow).picture(drawn, pictures[name]);
    look(window.trame.state.get("eye"));
  }

  // The whole scan: coarsely while something moves, as coarsely as this machine needs; it is a surface where that is still slow.
  const COARSEST = 0.25, QUICK_MS = 60, REST_MS = 250, LONGEST_MS = 2500;
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  let coarse = 1, finest = 1, resting = 0, quick = false; // quick: the scan was timed, and is drawn soon enough
  let coming = null, wished = 0; // the scan is sent once, and shown only where it is still what is asked for when it comes
  async function voxels() {
    let values = null;
    while (viewer && !values) values = await fetched("volume", (answer) => answer.arrayBuffer());
    coming = null;
    return values;
  }
  async function whole(told) {
    const turn = ++wished;
    if (!viewer) return;
    if (!told?.table) {
      viewer.whole = null;
      return viewer.redraw();
    }
    const drawn = (viewer.volume ??= window.ronnaplanVolume(viewer));
    drawn.paint(bytes(told.table), told.least);
    if (!drawn.ready) {
      const values = await (coming ??= voxels());
      if (!viewer) return;
      if (!drawn.ready) drawn.load(new Uint8Array(values), told);
      if (turn !== wished) return;
    }
    viewer.whole = drawn;
    if (!quick && viewer.eye && !(quick = measured())) return window.trame.trigger("volume_is_slow");
    finely();
  }
  // Finds how coarse the rays have to be; false where even the coarsest take too long.
  function measured() {
    const took = (share) => ((viewer.whole.share = share), viewer.timed(), viewer.timed());
    const quarter = took(COARSEST);
    if (quarter > SLOWEST_MS * 2) return (viewer.whole = null), false;
    const full = quarter / COARSEST ** 2;
    coarse = Math.min(1, Math.max(COARSEST, Math.sqrt(QUICK_MS / Math.max(full, 1))));
    finest = Math.min(1, Math.sqrt(LONGEST_MS / Math.max(full, 1)));
    return true;
  }
  function finely() {
    if (!viewer?.whole) return viewer?.redraw();
    viewer.whole.share = coarse;
    viewer.redraw();
    clearTimeout(resting);
    resting = setTimeout(() => {
      if (!viewer?.whole || coarse >= finest) return;
      viewer.whole.share = finest;
      viewer.redraw();
    }, REST_MS);
  }

  const LOOK_MS = 50;
  const looking = setInterval(() => {
    const canvas = document.querySelector("canvas[data-scene]");
    if (!canvas || !window.trame?.state) return; // the page is not there yet
    clearInterval(looking);
    begin(canvas);
  }, LOOK_MS);
})();
