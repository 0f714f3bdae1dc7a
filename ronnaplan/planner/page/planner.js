// Pointer, wheel, keys, buttons and fields, told to the server in the order in which they were used. One request at a
// time: while it is under way, moves are summed up.
(() => {
  const LARGE = "ronnaplan: the view shown alone";
  const queue = [];
  let busy = false;
  let send = null;

  // A field that is taken away while somebody types in it is left by that: the browser would tell its half of a number as
  // entered, and by then its handler works on the trajectory that is selected now. What is typed on goes nowhere. One whose
  // text was entered, or that was only visited, has the focus again where it is made anew for the same thing.
  const entered = new WeakMap();
  let left = null, dropped = false, focused = null;
  const typing = (field) => field.value !== field.defaultValue && field.value !== entered.get(field);
  window.addEventListener("change", (event) => entered.set(event.target, event.target.value), true);
  window.trame.app.directive("typed", {
    beforeUnmount(field, { value: owner }) {
      if (field === document.activeElement) {
        dropped = typing(field);
        left = dropped ? null : { id: field.id, owner, from: field.selectionStart, to: field.selectionEnd };
      }
      field.value = field.defaultValue;
    },
    mounted(field, { value: owner }) {
      field.owner = owner;
      window.ronnaplanHalf(field);
      if (left?.id !== field.id || left.owner !== owner) return;
      field.focus({ preventScroll: true });
      field.setSelectionRange(left.from, left.to);
      left = null;
    },
  });
  // A row of a long list that is selected elsewhere, in a view say, is brought into sight.
  const see = (row) => row.scrollIntoView({ block: "nearest" });
  window.trame.app.directive("seen", {
    mounted: (row, { value: on }) => on && see(row),
    updated: (row, { value: on, oldValue: before }) => on && !before && see(row),
  });
  // The focus of anything else that is taken away is its panel's, so that nobody who works by keyboard begins at the top.
  window.addEventListener("focusin", (event) => (focused = event.target));
  function keepFocus() {
    if (!focused || focused.isConnected || document.activeElement !== document.body) return;
    focused = left = null;
    document.querySelector("[role=tabpanel]")?.focus({ preventScroll: true });
  }

  // The page's own buttons and fields take their place in the queue, too: a button that overtook the press before it
  // would work on the place that was pointed at before.
  function sender() {
    if (!send) {
      const page = window.trame;
      send = page.trigger.bind(page);
      window.ronnaplanTellUntaken();
      page.trigger = async (name, args = []) => tell(name, args);
    }
    return send;
  }

  function tell(name, args) {
    const last = queue.length > 1 ? queue.at(-1) : null; // the first is under way
    if (last && last.name === name && (name === "move" || name === "hover")) {
      last.args = args;
    } else if (last && last.name === name && name === "wheel") {
      args[1] += last.args[1];
      last.args = args;
    } else {
      queue.push({ name, args, asked: performance.now() });
    }
    if (!busy) work();
  }

  async function work() {
    busy = true;
    while (queue.length) {
      const { name, args } = queue[0];
      try {
        await sender()(name, args);
      } catch (error) {
        console.error(error);
      }
      queue.shift();
    }
    busy = false;
  }
  // Since when the planner has owed an answer to what would be missed if it was not taken.
  const PASSING = ["move", "hover", "wheel", "sized", "nudge", "at_crosshair", "there", "leave"];
  window.ronnaplanUntaken = () => queue.find(({ name }) => !PASSING.includes(name))?.asked;

  function place(view, event) {
    const box = view.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top, box.width, box.height];
  }

  const viewOf = (event) => event.target.closest && event.target.closest("[data-view]");

  // Two fingers: drawn apart or together they zoom, moved alike they move the picture, whichever they begin with.
  const fingers = new Map(), BEGUN_PIXELS = 10, ZOOM_LOG = Math.log(1.15), SHIFT = true, LEFT = 0;
  let two = null;
  function between() {
    const [one, other] = [...fingers.values()];
    return {
      clientX: (one.clientX + other.clientX) / 2,
      clientY: (one.clientY + other.clientY) / 2,
      apart: Math.max(1, Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY)),
    };
  }
  function touched(event, view) {
    if (event.pointerType !== "touch") return false;
    fingers.set(event.pointerId, event);
    if (fingers.size === 2) {
      tell("release", [view.dataset.view, false]); // what the first finger took hold of; it clicks nothing
      two = { view, from: between(), does: "" };
    }
    return two !== null;
  }
  function slid(event) {
    if (!fingers.has(event.pointerId)) return false;
    fingers.set(event.pointerId, event);
    if (!two || fingers.size !== 2) return two !== null;
    const now = between(), { view, from } = two, name = view.dataset.view;
    if (!two.does) {
      if (Math.abs(now.apart - from.apart) > BEGUN_PIXELS) two.does = "zoom";
      else if (Math.hypot(now.clientX - from.clientX, now.clientY - from.clientY) > BEGUN_PIXELS) {
        two.does = "move";
        tell("press", [name, ...place(view, from), LEFT, SHIFT, false, false]);
      }
    }
    if (two.does === "move") tell("move", [name, ...place(view, now)]);
    const steps = two.does === "zoom" ? Math.trunc(Math.log(now.apart / from.apart) / ZOOM_LOG) : 0;
    if (steps) {
      tell("wheel", [name, -steps, true, ...place(view, now)]);
      two.from = { ...from, apart: from.apart * 1.15 ** steps };
    }
    return true;
  }
  function lifted(event) {
    if (!fingers.delete(event.pointerId)) return false;
    const held = two;
    if (held?.does === "move") tell("release", [held.view.dataset.view]), (held.does = "done");
    if (!fingers.size) two = null;
    return held !== null;
  }
  window.addEventListener("pointerdown", (event) => {
    dropped = false;
    const view = viewOf(event);
    if (!view) return;
    event.preventDefault();
    view.focus({ preventScroll: true, focusVisible: false });
    view.setPointerCapture(event.pointerId);
    if (touched(event, view)) return;
    const finger = event.pointerType === "touch";
    keyed = null;
    tell("hover", [view.dataset.view, ...place(view, event)]); // a finger hovers over nothing before
    tell("press", [view.dataset.view, ...place(view, event), event.button, event.shiftKey, event.ctrlKey, event.altKey, finger]);
  });
  window.addEventListener("pointermove", (event) => {
    if (slid(event) && two) return;
    const view = viewOf(event);
    if (view) keyed = null;
    if (view) tell(event.buttons ? "move" : "hover", [view.dataset.view, ...place(view, event)]);
  });
  // A finger that the system takes away, for a gesture of its own or as a palm, clicks nothing.
  function letGo(event) {
    const view = !lifted(event) && viewOf(event);
    if (view) tell("release", [view.dataset.view, event.type === "pointerup"]);
  }
  for (const name of ["pointerup", "pointercancel"]) window.addEventListener(name, letGo);
  window.addEventListener("contextmenu", (event) => viewOf(event) && event.preventDefault());
  // A notch of a mouse is a step; what a trackpad sends in many small pieces is summed up until it makes one.
  const NOTCH = 100, PIECE = 50, UNITS = [1, 33, 400];
  let rest = 0;
  function turned(event) {
    const pixels = event.deltaY * UNITS[event.deltaMode];
    if (Math.abs(pixels) >= PIECE) {
      rest = 0;
      return Math.sign(pixels) * Math.max(1, Math.round(Math.abs(pixels) / NOTCH / 1.2));
    }
    rest += pixels / NOTCH;
    const whole = Math.trunc(rest);
    rest -= whole;
    return whole;
  }
  window.addEventListener(
    "wheel",
    (event) => {
      const view = viewOf(event);
      if (!view) return;
      event.preventDefault();
      const steps = turned(event);
      if (steps) tell("wheel", [view.dataset.view, steps, event.ctrlKey, ...place(view, event)]);
    },
    { passive: false },
  );
  // Names over a picture are as large at every size of the view.
  const resized = new ResizeObserver((entries) => {
    for (const { target, contentRect } of entries) {
      const side = Math.max(1, Math.min(contentRect.width, contentRect.height));
      target.style.setProperty("--halves-a-pixel", 2 / side);
      const letters = Number(getComputedStyle(target).getPropertyValue("--letters"));
      tell("sized", [target.dataset.view, contentRect.width, contentRect.height, window.devicePixelRatio, letters]);
    }
  });
  const watched = new WeakSet();
  new MutationObserver(() => {
    keepFocus();
    for (const view of document.querySelectorAll("svg[data-view]")) {
      if (watched.has(view)) continue;
      resized.observe(view);
      if (localStorage.getItem(LARGE) === view.dataset.view) view.closest(".rp-view").classList.add("grown");
      watched.add(view);
    }
  }).observe(document.documentElement, { childList: true, subtree: true });

  // What only this tab shows: the list of keys, and one view enlarged, which the browser remembers.
  function help() {
    const list = document.getElementById("keys");
    list.showModal();
    list.scrollTop = 0; // the button that gets the focus stands at its end
  }
  window.addEventListener("click", (event) => {
    if (!event.target.closest) return;
    if (event.target.closest("[data-help]")) help();
    const skip = event.target.closest("[data-skip]");
    if (skip) document.getElementById(skip.dataset.skip).focus();
    const grown = event.target.closest("[data-grow]")?.closest(".rp-view");
    if (!grown) return;
    const large = grown.classList.toggle("grown");
    localStorage.setItem(LARGE, large ? grown.querySelector("[data-view]").dataset.view : "");
  });

  // A view that has the focus: arrows move the crosshair or turn the head, Shift ten times as far; Page Up and Page Down go
  // through, plus and minus come nearer, Enter clicks at the crosshair, or in the middle of the head.
  const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  const THROUGH = { PageUp: [-1, false], PageDown: [1, false], "+": [-1, true], "-": [1, true] };
  let keyed = null; // the view that is worked in by keyboard: what lies at the crosshair is told there
  window.addEventListener("focusin", ({ target }) => target.matches("svg[data-view]:focus-visible") && tellsOf(target));
  function tellsOf(view) {
    if (keyed !== view) tell("at_crosshair", [view.dataset.view]);
    keyed = view;
  }
  function moves(view, event) {
    const name = view.dataset.view, far = event.shiftKey ? 10 : 1;
    if (ARROWS[event.key] || THROUGH[event.key]) tellsOf(view);
    if (ARROWS[event.key]) tell("nudge", [name, ...ARROWS[event.key].map((way) => far * way)]);
    else if (THROUGH[event.key] && !event.ctrlKey) {
      const { width, height } = view.getBoundingClientRect(), [steps, nearer] = THROUGH[event.key];
      tell("wheel", [name, steps, nearer || name === "head", width / 2, height / 2, width, height]);
    } else if (event.key === "Enter") tell("click", [name, event.altKey]);
    else return false;
    event.preventDefault();
    return true;
  }

  // Along the tabs of the panels, as in any list of tabs.
  function steps(tab, event) {
    const tabs = [...tab.parentElement.children], at = tabs.indexOf(tab), last = tabs.length - 1;
    const to = { ArrowLeft: at ? at - 1 : last, ArrowRight: at < last ? at + 1 : 0, Home: 0, End: last }[event.key];
    if (to === undefined) return false;
    event.preventDefault();
    tabs[to].focus();
    tabs[to].click();
    return true;
  }

  // Up and down in a field for a number.
  function stepped(field, event) {
    const steps = { ArrowUp: 1, ArrowDown: -1 }[event.key] * field.dataset.step, now = parseFloat(field.value);
    if (!Number.isFinite(steps + now) || String(now) !== String(Number(field.value))) return;
    event.preventDefault();
    field.value = Number((now + steps).toFixed(3));
    for (const kind of ["input", "change"]) field.dispatchEvent(new Event(kind, { bubbles: true }));
  }

  window.addEventListener("keydown", (event) => {
    if (event.target.matches?.("svg[data-view]") && moves(event.target, event)) return;
    if (event.target.matches?.("[role=tab]") && steps(event.target, event)) return;
    const field = event.target.closest && event.target.closest("input, textarea, select, dialog");
    const control = event.ctrlKey || event.metaKey;
    if (field && field.type !== "checkbox") {
      stepped(field, event);
      if (!control || field.matches("dialog") || typing(field)) return; // what is typed is taken back by the browser
    }
    if (["Tab", "Escape"].includes(event.key)) dropped = false;
    if (dropped) return;
    if (event.key === "?") {
      help();
      return;
    }
    if (event.altKey) return; // the browser's own, as Alt + D to its address bar
    const key = (control ? "ctrl+" : "") + (control && event.shiftKey ? "shift+" : "") + event.key.toLowerCase();
    if (!window.trame?.state?.get("keys").includes(key)) return;
    event.preventDefault();
    tell("key", [key]);
  });
})();
