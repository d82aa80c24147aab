// Words for numbers, and what stands above the cards: counts, hours, the spread of the error, the progress of a batch at work.

const number = (value) => {
  if (value == null) return "–";
  const size = Math.abs(value);
  return value && (size < 1e-3 || size >= 1e4) ? value.toExponential(1) : String(+value.toPrecision(3));
};
const figures = (value) => value < 1000 ? number(value) : count(Math.round(value));
const count = (value) => value.toLocaleString("en");
const time = (s) => {
  if (s == null) return "–";
  if (s < 90) return `${s < 10 ? s.toFixed(1) : Math.round(s)} s`;
  return s < 5400 ? `${Math.round(s / 60)} min` : `${(s / 3600).toFixed(1)} h`;
};

function make(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) if (value !== null) element.setAttribute(key, value);
  element.append(...children);  // strings become text, never tags
  return element;
}

function pairs(values) {
  return values.filter(([, value]) => value != null && value !== "")
    .flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, String(value))]);
}

function showNumbers(element, rows, progress) {
  const seconds = rows.reduce((sum, row) => sum + (row.seconds ?? 0), 0), hourly = progress?.per_hour ?? perHour(rows);
  const values = [["Captures", count(rows.length)], ["Hours of fits", seconds && figures(seconds / 3600)],
    ["Captures an hour", hourly && figures(hourly)]];
  element.replaceChildren(...values.filter(([, value]) => value).map((pair) => make("div", {}, ...pairs([pair]))));
}

// Captures ended in an hour in which at least one was at work: between two goes at a library time stands still.
function perHour(rows) {
  const spans = rows.filter((row) => row.date && row.seconds).map((row) => {
    const end = Date.parse(row.date);
    return [end - 1000 * row.seconds, end];
  });
  let busy = 0, until = -Infinity;
  for (const [begin, end] of spans.sort((a, b) => a[0] - b[0])) {
    busy += Math.max(0, end - Math.max(begin, until));
    until = Math.max(until, end);
  }
  return busy > 0 ? spans.length / (busy / 3.6e6) : null;
}

function showProgress(section, states, progress) {
  const all = Object.values(states).reduce((a, b) => a + b, 0), ended = states.done + states.failed;
  section.hidden = !(states.running || states.pending);
  if (section.hidden) return;
  const [bar, text] = section.children;
  bar.setAttribute("aria-label", Object.entries(states).map(([state, n]) => `${count(n)} ${state}`).join(", "));
  bar.replaceChildren(...Object.entries(states).map(([state, n]) => {
    const part = make("i", { class: state });
    part.style.width = `${100 * n / all}%`;
    return part;
  }));
  const words = [`${count(ended)} of ${count(all)} ended, ${Math.floor(100 * ended / all)} %`];
  if (progress?.per_hour != null) words.push(`${figures(progress.per_hour)} captures an hour`);
  if (progress?.left_seconds != null) words.push(`about ${time(progress.left_seconds)} left`);
  text.textContent = words.join(" · ");
}

// How often each error occurs, on a logarithmic axis: of all materials, and on top of it of those shown.
const BINS = 48, LEFT = 4, RIGHT = 476, TOP = 4, FLOOR = 88;
function showErrors(figure, all, shown) {
  const values = (rows) => Float64Array.from(rows.map((row) => row.error).filter((error) => error > 0)).sort();
  const every = all.errors ??= values(all), some = shown.length === all.length ? every : values(shown);
  figure.hidden = every.length < 2;
  if (figure.hidden) return;
  const low = Math.log10(every[0]), span = Math.log10(every[every.length - 1]) - low || 1;
  const share = (error) => (Math.log10(error) - low) / span;
  const bins = (errors) => {
    const found = new Uint32Array(BINS);
    for (const error of errors) found[Math.min(BINS - 1, Math.floor(share(error) * BINS))]++;
    return found;
  };
  const heights = bins(every), most = Math.max(...heights), svg = figure.firstElementChild, wide = (RIGHT - LEFT) / BINS;
  const draw = (name, attributes, text = "") => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    element.textContent = text;
    return element;
  };
  const high = (n) => Math.max(1, n / most * (FLOOR - TOP)).toFixed(1);
  const bar = (n, k) => n && `M${(LEFT + k * wide).toFixed(1)} ${FLOOR}v-${high(n)}h${(wide - 1).toFixed(1)}V${FLOOR}z`;
  const bars = (numbers, kind) => draw("path", { class: kind, d: Array.from(numbers, bar).filter(Boolean).join("") });
  const marks = [0, 1 / 3, 2 / 3, 1].map((at, k) => draw("text", { x: LEFT + at * (RIGHT - LEFT), y: 104,
    "text-anchor": k === 0 ? "start" : k === 3 ? "end" : "middle" }, number(10 ** (low + at * span))));
  svg.replaceChildren(bars(heights, "all"), bars(bins(some), "shown"), ...marks);
  const at = (part) => number(some[Math.min(some.length - 1, Math.floor(part * some.length))]);
  const words = !some.length ? "None of the materials shown has an error" :
    `Error of ${count(some.length)} materials shown: half are below ${at(0.5)}, 9 of 10 below ${at(0.9)}`;
  figure.lastElementChild.textContent = words + ".";
  svg.setAttribute("aria-label", words + `. All lie from ${number(every[0])} to ${number(every[every.length - 1])}.`);
}
