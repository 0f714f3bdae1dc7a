// Files of the case: those that are made when asked for are told meanwhile; readings are taken by drop.
(() => {
  const SECOND_MS = 1000;
  const making = new Map(); // what was asked for and has not come yet, since when
  let last = "";
  // The panel is taken away and made anew as one looks at others; a screen reader is told what is made, not every second.
  function show() {
    const put = (id, text) => {
      const line = document.getElementById(id);
      if (line && line.textContent !== text) line.textContent = text;
    };
    put("making", making.size ? [...making.keys()].map((name) => `${name} is being made`).join(", ") : last);
    const longest = performance.now() - Math.min(...making.values());
    put("making-seconds", making.size ? `... ${Math.floor(longest / SECOND_MS)} s` : "");
  }
  setInterval(show, SECOND_MS);

  async function download(name) {
    if (making.has(name)) return; // pressed again by who saw nothing come, it would all be done again
    making.set(name, performance.now());
    show();
    last = await taken(name);
    making.delete(name);
    show();
  }
  async function taken(name) {
    const answer = await fetch(`download/${name}`).catch(() => null);
    const content = await answer?.blob().catch(() => null); // nothing where the line is cut
    if (!content || !answer.ok) {
      const why = `${name}: ${content ? await content.text() : "the planner does not answer"}`;
      window.trame.state.set("message", why); // in sight whichever panel is shown by now
      return why;
    }
    const url = URL.createObjectURL(content);
    const called = decodeURIComponent(answer.headers.get("Content-Disposition").split("UTF-8''")[1]);
    Object.assign(document.createElement("a"), { href: url, download: called }).click();
    setTimeout(() => URL.revokeObjectURL(url), 60000);
    return `${called} was downloaded`;
  }
  window.addEventListener("click", (event) => {
    const link = event.target.closest?.("[data-download]");
    if (!link) return;
    event.preventDefault();
    download(link.dataset.download);
  });

  async function take(file) {
    const answer = await fetch(`readings?${new URLSearchParams({ name: file.name })}`, { method: "PUT", body: file }).catch(() => null);
    const told = await answer?.json().catch(() => null);
    window.trame.state.set("message", told ? (told.error ?? "") : "the file could not be sent; is the planner still running?");
  }
  for (const name of ["dragover", "drop", "dragleave"]) {
    window.addEventListener(name, (event) => {
      if (![...event.dataTransfer.types].includes("Files")) return;
      event.preventDefault();
      document.querySelector(".rp-main")?.classList.toggle("rp-over", name === "dragover");
    });
  }
  window.addEventListener("drop", (event) => [...event.dataTransfer.files].slice(0, 1).forEach(take));
  window.addEventListener("change", (event) => event.target.id === "readings-file" && [...event.target.files].forEach(take));
})();
