// As much of a name's beginning and of its end as `fits`, by the rule of `abridged` in text.py: a test holds the two together.
window.ronnaplanShortened = (name, fits) => {
  const letters = [...name], part = (from, to) => letters.slice(from, to).join("");
  const abridged = (longest) => `${part(0, Math.floor(longest / 2)).trimEnd()}\u2026${part(letters.length - Math.floor((longest - 1) / 2)).trimStart()}`;
  if (fits(name)) return name;
  let kept = 2, most = letters.length;
  while (most - kept > 1) {
    const middle = (kept + most) >> 1;
    if (fits(abridged(middle))) kept = middle;
    else most = middle;
  }
  return kept > 2 ? abridged(kept) : "\u2026";
};
// Where names are written over a canvas, by the rule of names.py, in pixels: a test holds the two together.
// Returns a function that takes a name's width and its place on the screen, and tells the left and top of its box, or null
// where there is no room for it.
window.ronnaplanNames = (canvas) => {
  const LINE = 15, APART = 10; // from one line to the next; from a place to its name
  const taken = [];
  return (width, across, down) => {
    const room = canvas.clientWidth, right = across + APART, before = across - APART - width;
    if (across < 0 || across > room || down < 0 || down > canvas.clientHeight) return null; // what of it would be seen could be read as another name
    const left = right + width <= room ? right : before >= 0 ? before : Math.max(0, room - width);
    const first = Math.max(0, down - APART - LINE);
    const free = (top) => top >= 0 && top + LINE <= canvas.clientHeight && !taken.some((one) => left < one.right && one.left < left + width && top < one.top + LINE && one.top < top + LINE);
    const top = [0, 1, -1, 2, -2, 3, -3].map((lines) => first + lines * LINE).find(free);
    if (top === undefined) return null;
    taken.push({ left, right: left + width, top });
    return [left, top];
  };
};
