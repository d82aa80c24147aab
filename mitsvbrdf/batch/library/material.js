// One material: its card, and all that is known about it.

// All that a card shows: while it stays the same, so does the card.
function stampOf(row) {
  row.stamp ??= JSON.stringify([row.key, row.state, row.name, row.apart, row.error, row.preview, row.report, row.log,
    row.reason, row.warnings?.length]);
  return sortedBy() + row.stamp;
}

// What a card tells beside the name: the number that materials are sorted by, the error where that is none.
const UNITS = { seconds: duration, date: moment, memory: (n) => `${n.toFixed(1)} GiB`, attempts: (n) => several(n, "attempt") };
const CALLED = { error: "error", left_out_error: "left-out error", burn_in: "burn-in" };
const sortedBy = () => ["name", "warnings"].includes(view.sort) ? "error" : view.sort;
function told(row) {
  const field = sortedBy(), value = field === "date" ? row.date : numberOf(row, field);
  if (value == null) return "";
  return field in CALLED ? `${number(value, 2)} ${CALLED[field]}` : UNITS[field](value);  // too long, it loses its end
}

function makeCard(row) {
  const main = row.report ? make("a", { class: "card", href: row.report }) : make("button", { class: "card", type: "button" });
  main.append(makePicture(row), make("span", { class: "name", dir: "auto", title: row.name }, row.name));
  if (row.apart) main.append(make("span", { class: "apart", dir: "auto", title: row.apart }, row.apart));
  if (row.report) main.addEventListener("click", keepNow);
  else main.addEventListener("click", () => showDetails(row));
  const more = make("button", { class: "more", type: "button", "aria-label": `Details of ${row.name}` }, "⋯");
  more.addEventListener("click", () => showDetails(row));
  return make("li", { class: row.state }, main, make("div", { class: "under" }, makeVerdict(row), more));
}

function makePicture(row) {
  const picture = make("span", { class: "picture" });
  if (row.preview) {
    const image = make("img", { alt: "", decoding: "async", "data-src": row.preview });
    image.addEventListener("error", () => image.getAttribute("src") && image.replaceWith(make("span", {}, "no picture")));
    picture.append(image);
  } else if (row.state === "failed") {
    picture.append(make("span", { dir: "auto" }, make("b", {}, "Failed"),
      make("span", { class: "why", title: row.reason }, row.reason || "for a reason that nobody noted")));
  } else picture.append(make("span", {}, { done: "no picture", pending: "waiting" }[row.state] ?? row.state));
  return picture;
}

function makeVerdict(row) {
  if (row.log) return make("a", { class: "log", href: row.log, "aria-label": `Log of ${row.name}` }, "Log");
  const verdict = make("span", { class: "told" }, make("span", {}, told(row))), warnings = row.warnings ?? [];
  if (warnings.length) verdict.append(make("span", { class: "bad", title: warnings.join("\n") }, `⚠ ${warnings.length}`));
  return verdict;
}

function showDetails(row) {
  const dialog = $("details"), [form, image, links, list] = dialog.children;
  form.firstElementChild.textContent = row.name;
  image.hidden = !row.preview;
  if (row.preview) image.src = row.preview;
  else image.removeAttribute("src");
  image.alt = `${row.name}, lit`;
  links.replaceChildren(...[["Report", row.report], ["Picture alone", row.preview], ["Log", row.log]]
    .filter(([, to]) => to).map(([name, to]) => make("a", { href: to }, name)));
  const memory = numberOf(row, "memory");
  list.replaceChildren(...pairs([
    ["State", row.state], ["Reason", row.reason], ["Warnings", row.warnings?.join("\n")],
    ["Error", row.error && number(row.error)], ["Left-out error", row.left_out_error && number(row.left_out_error)],
    ["Burn-in", row.burn_in && number(row.burn_in)], ["Time", row.seconds && duration(row.seconds)],
    ["Memory", memory && `${memory.toFixed(2)} GiB`], ["Attempts", row.attempts], ["Ended", moments(row.date)],
    ["Method", row.method], ["Resolution", row.resolution && `${row.resolution} px`],
    ["Photos", row.photos], ["Tags", row.tags?.join(", ")], ["Source", row.source], ["Options", row.options],
    ["Worker", [row.worker, row.host].filter(Boolean).join(" on ")], ["Folder", row.folder], ["Identity", row.id],
  ]));
  dialog.showModal();
  dialog.scrollTop = 0;
}
