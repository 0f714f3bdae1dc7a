// The start page: looks through folders, takes what is dropped, lists the series in it and opens one.
(() => {
  const one = (id) => document.getElementById(id);
  const made = (kind, rest = {}, ...inside) => {
    const element = Object.assign(document.createElement(kind), rest);
    element.append(...inside);
    return element;
  };
  function tell(id, text) {
    one(id).textContent = text;
    one(id).hidden = !text;
  }
  async function ask(address, options = {}) {
    const answer = await fetch(address, options).catch(() => null);
    if (!answer) throw new Error("the planner does not answer; is it still running?");
    if (answer.status === 404) { // another tab has opened a case: the planner is here now
      location.reload();
      return new Promise(() => {});
    }
    const told = await answer.json().catch(() => ({ error: `the planner refused it (${answer.status})` }));
    if (told.error) throw new Error(told.error);
    return told;
  }
  // One thing at a time, told while it lasts; what goes wrong is shown. What is pressed meanwhile is done next: the last of it,
  // and nothing that is being done already.
  let doing = "", next = null;
  const now = (text) => tell("busy", (doing = text));
  async function work(text, done) {
    if (doing) {
      next = text === doing ? null : [text, done];
      return tell("busy", next ? `${doing} next: ${text}` : doing);
    }
    now(text);
    tell("error", "");
    document.body.setAttribute("aria-busy", "true");
    try {
      await done();
    } catch (error) {
      tell("error", error.message);
    }
    now("");
    document.body.removeAttribute("aria-busy");
    const waited = next;
    next = null;
    if (waited) work(...waited);
  }

  // --- folders
  const query = (values) => new URLSearchParams(values).toString();
  async function browse(at) {
    const listed = await ask(`folders?${query({ at })}`);
    const parts = listed.at ? listed.at.split("/") : [];
    const steps = [listed.root, ...parts].map((name, n) =>
      made("button", { type: "button", onclick: () => go(parts.slice(0, n).join("/")) }, n ? name : name || "/"));
    const look = made("button", { type: "button", className: "look", onclick: () => find(listed.at) }, "look for series here");
    const goesOn = document.activeElement.closest("#path, #entries"); // what is pressed there is taken away
    one("path").replaceChildren(...steps.flatMap((step, n) => (n ? ["/", step] : [step])), look);
    const entries = listed.entries.map((entry) => {
      const press = () => (entry.folder ? go(entry.at) : find(entry.at));
      const label = made("button", { type: "button", onclick: press }, entry.folder ? `${entry.name}/` : entry.name);
      if (entry.case) label.append(made("span", { className: "case" }, "case"));
      return made("li", {}, label);
    });
    const empty = `no folders in here${at ? "" : "; the button above lists its scans"}`;
    if (!entries.length) entries.push(made("li", {}, made("span", { className: "empty" }, empty)));
    if (listed.more) entries.push(made("li", {}, made("span", { className: "empty" }, `and ${listed.more} more`)));
    one("entries").replaceChildren(...entries);
    if (goesOn) steps.at(-1).focus();
    if (at && !listed.entries.length) await search(at); // where else would a scan be
  }
  const called = (at) => at || "the root";
  const searching = (at) => `looking for series in ${called(at)} ...`;
  async function search(at) {
    now(searching(at));
    await list({ at }, `Series in ${called(at)}`);
  }
  const go = (at) => work(`opening ${called(at)} ...`, () => browse(at));
  const find = (at) => work(searching(at), () => search(at));

  // --- what is dropped
  async function inside(entry, path, found) {
    if (entry.isFile) {
      const file = await new Promise((good, bad) => entry.file(good, bad));
      if (!file.name.startsWith(".")) found.push({ file, name: path + file.name });
      return;
    }
    const reader = entry.createReader();
    for (;;) {
      const some = await new Promise((good, bad) => reader.readEntries(good, bad));
      if (!some.length) return;
      for (const next of some) await inside(next, `${path}${entry.name}/`, found);
    }
  }
  const take = (listed) =>
    work("taking what was dropped ...", async () => {
      const found = await listed();
      if (!found.length) throw new Error("there was no file in it; drop a folder or a zip archive");
      const { drop } = await ask("drop", { method: "POST" });
      for (const [n, { file, name }] of found.entries()) {
        await ask(`dropped?${query({ drop, name })}`, { method: "PUT", body: file });
        tell("busy", `taking what was dropped: ${n + 1} of ${found.length} ...`);
      }
      tell("busy", "looking for series ...");
      await list({ drop }, "Series in what was dropped");
    });
  const zone = one("drop");
  for (const name of ["dragover", "drop", "dragleave"]) {
    window.addEventListener(name, (event) => {
      event.preventDefault();
      zone.classList.toggle("over", name === "dragover");
    });
  }
  window.addEventListener("drop", (event) => {
    const entries = [...event.dataTransfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
    take(async () => {
      const found = [];
      for (const entry of entries) await inside(entry, "", found);
      return found;
    });
  });
  for (const id of ["folder", "file"]) {
    one(id).addEventListener("change", (event) => {
      const files = [...event.target.files].filter((file) => !file.name.startsWith("."));
      take(async () => files.map((file) => ({ file, name: file.webkitRelativePath || file.name })));
    });
  }

  // --- series
  const range = (pair) => (pair ? [...new Set(pair.map((value) => value.toFixed(2)))].join(" to ") : "?");
  async function list(of, heading) {
    one("found").hidden = true; // what stands there is of another place
    one("heard").textContent = "";
    const { series, name } = await ask(`series?${query(of)}`);
    one("found").querySelector("h2").textContent = heading;
    one("found").hidden = false;
    one("case").hidden = !name;
    one("name").value = name;
    one("found").querySelector("tbody").replaceChildren(...series.map((row) => {
      // in a new case there is nothing yet that could be of another scan
      const stranger = row.strangers && !name ? [`of another scan in its case: ${row.strangers}; move that, or this scan, to a folder of its own`] : [];
      const problems = [...row.problems, ...stranger], usable = !problems.length;
      const picture = row.drawn ? made("img", { src: `thumbnail/${row.key}`, alt: "" }) : made("span", { className: "none" }, "no picture");
      const kernel = row.part.includes(`kernel ${row.kernel}`) ? "" : row.kernel; // which its part tells then
      const title = made("td", {}, `${row.modality} ${row.description || "(no description)"}`, made("small", {}, [kernel, ...row.part, row.series].filter(Boolean).join(", ")));
      const told = made("td", {}, made("span", { className: usable ? "yes" : "no" }, usable ? "can be planned in" : problems.join("; ")));
      if (usable) for (const note of row.notes) told.append(made("small", { className: "doubt" }, note));
      const press = made("button", { type: "button", disabled: !usable, onclick: () => open(row.key) }, row.known && !name ? "go on" : "plan");
      press.setAttribute("aria-label", `${press.textContent}: ${row.description || row.series}`);
      const voxels = row.pixel_mm ? `${range(row.pixel_mm)} x ${range(row.spacing_mm)}` : "";
      return made("tr", {}, made("td", {}, picture), title, made("td", {}, row.images), made("td", {}, voxels), told, made("td", {}, press));
    }));
    const usable = one("found").querySelectorAll("tbody button:enabled").length;
    one("heard").textContent = `${heading}: ${series.length}, of which ${usable} can be planned in`;
    one("found").scrollIntoView({ block: "nearest" });
    return series;
  }
  const open = (key) => work("reading the scan ...", () => begin(key));
  async function begin(key) {
    await ask(`open?${query({ key, name: one("name").value.trim() })}`, { method: "POST" });
    tell("busy", "opening the planner ...");
    for (;;) {
      // the start page answers no such address, the planner that takes its place does
      const there = await fetch("planner_page/planner.css", { method: "HEAD", cache: "no-store" }).catch(() => null);
      if (there?.ok) return location.reload();
      await new Promise((good) => setTimeout(good, 300));
    }
  }

  // --- an archive
  async function shelf() {
    const { name } = await ask("archive");
    one("archive").hidden = !name;
    one("archive-name").textContent = name;
  }
  function shelved(series) {
    const body = one("archive").querySelector("tbody");
    one("archive").querySelector("table").hidden = false;
    body.replaceChildren(...series.map((row) => {
      const picture = made("img", { loading: "lazy", src: `archive/${row.key}`, alt: "" });
      picture.onerror = () => picture.replaceWith(made("span", { className: "none" }, "no picture"));
      const title = made("td", {}, `${row.modality} ${row.description || "(no description)"}`, made("small", {}, `${row.study} ${row.series_uid}`));
      const press = made("button", { type: "button", onclick: () => fetched(row) }, "fetch and plan");
      press.setAttribute("aria-label", `fetch and plan: ${row.description || row.series_uid}`);
      const patient = made("td", {}, row.patient_id, made("small", {}, row.patient_name));
      return made("tr", {}, made("td", {}, picture), title, made("td", {}, row.instances ?? "?"), patient, made("td", {}, row.date), made("td", {}, press));
    }));
    if (!series.length) body.append(made("tr", {}, made("td", { colSpan: 6 }, "no such series; try another ID or other days")));
  }
  one("look").addEventListener("submit", (event) => {
    event.preventDefault();
    const days = [one("from").value, one("to").value].map((day) => day.replaceAll("-", ""));
    const date = days[0] === days[1] ? days[0] : days.join("-");
    work("looking in the archive ...", async () => {
      const { series } = await ask(`archive?${query({ patient: one("patient").value, date })}`);
      if (!series) throw new Error("nothing says which series; give a patient's ID or a day");
      shelved(series);
    });
  });
  const fetched = (row) =>
    work(`fetching ${row.instances ?? "the"} images ...`, async () => {
      const { drop } = await ask(`fetch?${query({ key: row.key })}`, { method: "POST" });
      const series = await list({ drop }, "Series that were fetched");
      const usable = series.filter((one) => !one.problems.length);
      if (usable.length === 1) await begin(usable[0].key);
    });

  shelf().catch((error) => tell("error", error.message));
  go("");
})();
