// The pictures of the views, drawn beneath what Vue draws over them: they come as bytes, and are decoded beside the page.
(() => {
  const shown = new Map(), watchers = [];
  const decoded = ({ bytes, kind }) => createImageBitmap(new Blob([bytes], { type: kind })).catch(() => null);

  // The first ones are shown with the page, not after it: Vue makes it once they are decoded.
  const ahead = new Map(), { app, state } = window.trame, mount = app.mount;
  for (const [name, picture] of Object.entries(state.get())) {
    if (name.startsWith("picture_") && picture) ahead.set(picture, decoded(picture));
  }
  const idle = window.requestIdleCallback ?? setTimeout, SOON = { timeout: 1000 }; // where much else runs, nothing is ever idle
  let painted;
  const seen = new Promise((resolve) => (painted = resolve));
  app.mount = async (place) => {
    await Promise.all(ahead.values());
    mount(place);
    requestAnimationFrame(() => setTimeout(idle, 0, painted, SOON)); // the frame with them is out of the way then
  };
  // What stands in <after-pictures> is compiled and made once they are painted.
  app.component("after-pictures", Vue.defineAsyncComponent(() => seen.then(() => ({ template: "<slot />" }))));

  async function draw(canvas, picture) {
    const view = canvas.dataset.picture;
    canvas.hidden = !picture;
    if (!picture) return shown.delete(view);
    const bitmap = await (ahead.get(picture) ?? decoded(picture));
    ahead.delete(picture);
    if (!bitmap) return;
    if (picture.number > (shown.get(view) ?? 0)) {
      if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) {
        Object.assign(canvas, { width: bitmap.width, height: bitmap.height });
      }
      canvas.getContext("2d", { alpha: false }).drawImage(bitmap, 0, 0);
      canvas.dataset.number = picture.number;
      shown.set(view, picture.number);
      for (const watch of watchers) watch(view, canvas);
    }
    bitmap.close();
  }

  const begun = new WeakSet();
  function begin(canvas) {
    begun.add(canvas);
    const name = `picture_${canvas.dataset.picture}`;
    state.watch([name], (picture) => draw(canvas, picture)); // with the present one at once
  }
  new MutationObserver(() => {
    for (const canvas of document.querySelectorAll("canvas[data-picture]")) if (!begun.has(canvas)) begin(canvas);
  }).observe(document.documentElement, { childList: true, subtree: true });

  // Calls back with view and canvas now, and whenever a picture is drawn.
  window.ronnaplanPictures = (watch) => {
    watchers.push(watch);
    for (const canvas of document.querySelectorAll("canvas[data-number]")) watch(canvas.dataset.picture, canvas);
  };
})();
