// Pointer, wheel and keys, told to the server. One request at a time: while it is under way, moves are summed up.
(() => {
  const queue = [];
  let busy = false;

  function tell(name, args) {
    const last = queue.at(-1);
    if (last && last.name === name && name === "move") {
      last.args = args;
    } else if (last && last.name === name && name === "wheel") {
      args[1] += last.args[1];
      last.args = args;
    } else {
      queue.push({ name, args });
    }
    if (!busy) work();
  }

  async function work() {
    busy = true;
    while (queue.length) {
      const { name, args } = queue.shift();
      try {
        await window.trame.trigger(name, args);
      } catch (error) {
        console.error(error);
      }
    }
    busy = false;
  }

  function place(view, event) {
    const box = view.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top, box.width, box.height];
  }

  const viewOf = (event) => event.target.closest && event.target.closest("[data-view]");

  window.addEventListener("pointerdown", (event) => {
    const view = viewOf(event);
    if (!view) return;
    event.preventDefault();
    view.setPointerCapture(event.pointerId);
    tell("press", [view.dataset.view, ...place(view, event), event.button, event.shiftKey]);
  });
  window.addEventListener("pointermove", (event) => {
    const view = viewOf(event);
    if (view && event.buttons) tell("move", [view.dataset.view, ...place(view, event)]);
  });
  window.addEventListener("pointerup", (event) => {
    const view = viewOf(event);
    if (view) tell("release", [view.dataset.view]);
  });
  window.addEventListener("contextmenu", (event) => viewOf(event) && event.preventDefault());
  window.addEventListener(
    "wheel",
    (event) => {
      const view = viewOf(event);
      if (!view) return;
      event.preventDefault();
      tell("wheel", [view.dataset.view, Math.sign(event.deltaY), event.ctrlKey, ...place(view, event)]);
    },
    { passive: false },
  );
  window.addEventListener("keydown", (event) => {
    if (event.target.closest && event.target.closest("input, textarea")) return;
    const key = (event.ctrlKey || event.metaKey ? "ctrl+" : "") + event.key.toLowerCase();
    if (!(window.trame && window.trame.state.get("keys").includes(key))) return;
    event.preventDefault();
    tell("key", [key]);
  });
})();
