// Whether the planner can be reached, asked from the page's first moment: before anything else of it has come, and when
// all else of it is lost. A planner that does not answer is asked for; once it answers again, the page goes on where it was if
// its socket does, else the state is loaded anew.
(() => {
  const ASK_MS = 1000, MISSES = 3, AGAIN_MS = 5000;
  const ENDING_MS = 2000; // a planner that ends closes sockets first, and answers for a moment: loaded then, the page would find nobody
  const GONE = `<h2>The planner cannot be reached</h2>
    <p>It has ended, or does not answer. What was done is kept in the case's folder. What was dragged, typed or clicked since it last
    answered is gone if it has ended; if it was only held up, it is taken then.</p>
    <p id="gone-how">Start it again with <kbd>ronnaplan view</kbd>: this page goes on by itself, as it does where the planner was only held
    up. If it prints another address, as where another program has its port, open that.</p>`;
  const ELSEWHERE = "Another planner answers here: open the address that yours printed.";
  const KEPT_OUT = "The planner answers, but took no connection from this page: it may be open in too many. Trying again ...";
  let missed = 0, lostAt = null, heardAt = 0;

  // trame's client would first ask a launcher where its socket is; there is none, and it believes the address.
  const address = new URL(location), socket = new URL("ws", document.baseURI);
  socket.protocol = socket.protocol.replace("http", "ws");
  address.searchParams.set("sessionURL", socket);
  history.replaceState(null, "", address);

  // The page shows what comes through one socket: one that never opened, or was closed, is as good as no page.
  const Socket = window.WebSocket;
  window.WebSocket = class extends Socket {
    constructor(...given) {
      super(...given);
      this.addEventListener("close", () => {
        lostAt = performance.now();
        half ??= typed(); // trame takes the page's content away then
      });
      this.addEventListener("message", () => (heardAt = performance.now()));
    }
  };
  const place = () => document.getElementById("app");
  const shown = () => place().hasAttribute("data-v-app"); // set by Vue
  function lost() {
    if (lostAt === null) return false;
    if (!shown()) place().textContent = KEPT_OUT;
    return performance.now() - lostAt > (shown() ? ENDING_MS : AGAIN_MS);
  }

  // Whether the socket still leads to the planner: one that was cut off without a word seems open.
  async function hears() {
    const asked = performance.now();
    window.trame?.trigger?.("there", []);
    while (lostAt === null && heardAt < asked && performance.now() - asked < AGAIN_MS)
      await new Promise((resolve) => setTimeout(resolve, ASK_MS / 10));
    return lostAt === null && heardAt >= asked;
  }

  // What takes the focus from a field has it enter what stands there, half of a number as it may be: nothing is entered then.
  let opening = false;
  window.addEventListener("change", (event) => opening && event.stopImmediatePropagation(), true);
  // What is half typed is typed again: into its field, or into that of the page that is loaded anew, if it is for the same
  // thing (owner, see planner.js) of the same scan, and says the same: another tab may have opened another case meanwhile.
  const HALF = "ronnaplan: half typed", scan = () => window.trame.state.get("scan");
  let half = null;
  function typed() {
    const field = document.activeElement;
    if (!field?.matches("input, textarea") || field.value === field.defaultValue) return null;
    return { field, id: field.id, owner: field.owner, scan: scan(), before: field.defaultValue, text: field.value };
  }
  function typeAgain(field, text) {
    field.focus({ preventScroll: true });
    field.value = field.defaultValue;
    field.select();
    document.execCommand("insertText", false, text); // Enter, or leaving the field, enters it
  }
  window.ronnaplanHalf = (field) => {
    const left = JSON.parse(sessionStorage.getItem(HALF));
    if (left?.id !== field.id) return;
    sessionStorage.removeItem(HALF);
    if (left.owner === field.owner && left.scan === scan() && left.before === field.defaultValue) typeAgain(field, left.text);
  };
  const UNTAKEN = "ronnaplan: untaken";
  const LOST = "The planner was lost before it answered what was clicked or entered last, which may not have been taken: see whether it is there.";
  window.ronnaplanTellUntaken = () => {
    if (sessionStorage.getItem(UNTAKEN) === scan()) window.trame.state.set("message", LOST);
    sessionStorage.removeItem(UNTAKEN);
  };
  function reload() {
    if (window.ronnaplanUntaken?.()) sessionStorage.setItem(UNTAKEN, scan());
    if (half) sessionStorage.setItem(HALF, JSON.stringify({ ...half, field: undefined }));
    location.reload();
  }
  function tellGone() {
    half ??= typed();
    const told = Object.assign(document.createElement("dialog"), { id: "gone", className: "rp-help", innerHTML: GONE });
    told.addEventListener("cancel", (event) => event.preventDefault()); // Escape answers for no planner
    document.documentElement.append(told); // beside the body, whose content trame takes away when the connection is lost
    opening = true;
    told.showModal();
    opening = false;
  }
  function goOn(told) {
    told.close();
    told.remove();
    if (half?.field.isConnected) typeAgain(half.field, half.text);
    half = null;
  }

  // Over a slow line, or by a crowded machine, an answer takes its time, until which nothing else shows that one clicked.
  // A planner that hangs is told of here, too, though nothing was clicked: what stands in the way waits for sure ones.
  const SLOW_MS = 2000, HUNG_MS = 3000;
  let askedAt = NaN;
  function tellWaiting() {
    const line = document.getElementById("unanswered"), now = performance.now();
    const isSlow = now - window.ronnaplanUntaken?.() > SLOW_MS, hangs = now - askedAt > HUNG_MS;
    const text = isSlow ? "not answered yet ..." : hangs ? "the planner does not answer yet ..." : "";
    if (line && line.textContent !== text) line.textContent = text; // read out once, not at every look
  }
  setInterval(tellWaiting, ASK_MS / 2);

  async function ask() {
    const limit = AbortSignal.timeout(4 * ASK_MS); // one that is busy answers late
    askedAt ||= performance.now();
    const status = await fetch("planner_page/planner.css", { method: "HEAD", cache: "no-store", signal: limit }).then(
      (answer) => answer.status,
      () => 0,
    );
    const there = status === 200;
    if (status) askedAt = NaN;
    missed = there ? 0 : missed + 1;
    const gone = document.getElementById("gone");
    if (status === 404 || (there && (lost() || (gone && !(await hears()))))) return reload(); // 404: the start page took the planner's place
    if (there && gone) goOn(gone);
    if (gone && status === 403) gone.querySelector("#gone-how").textContent = ELSEWHERE;
    if (missed >= MISSES && !gone) tellGone();
    setTimeout(ask, ASK_MS);
  }
  setTimeout(ask, ASK_MS);
})();
