// Files of the case: those that are made when asked for are told meanwhile; readings are taken by drop.
(() => {
  const say = (text) => {
    const line = document.getElementById("making");
    if (line) line.textContent = text;
  };

  async function download(name) {
    say(`${name} is being made ...`);
    const answer = await fetch(`download/${name}`).catch(() => null);
    if (!answer?.ok) return say(answer ? `${name}: ${await answer.text()}` : "the planner does not answer");
    const url = URL.createObjectURL(await answer.blob());
    const called = decodeURIComponent(answer.headers.get("Content-Disposition").split("UTF-8''")[1]);
    Object.assign(document.createElement("a"), { href: url, download: called }).click();
    setTimeout(() => URL.revokeObjectURL(url), 60000);
    say(`${called} was downloaded`);
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
