// Words for numbers, times and materials. Nothing here touches the page, so node can run it too.

const number = (value, digits = 3) => {
  if (value == null) return "–";
  const size = Math.abs(value);
  return value && (size < 1e-3 || size >= 1e4) ? value.toExponential(1) : String(+value.toPrecision(digits));
};
const count = (value) => value.toLocaleString("en");
const several = (n, one) => `${count(n)} ${one}${n === 1 ? "" : "s"}`;

// A length of time in at most two units, the twin of `duration` in progress.py: 0.8 s, 40 s, 12 min, 3 h 20 min, 2 days 5 h.
function duration(seconds) {
  if (seconds == null) return "–";
  if (seconds < 9.95) return `${seconds.toFixed(1)} s`;
  if (seconds < 89.5) return `${Math.round(seconds)} s`;
  const minutes = Math.round(seconds / 60), hours = Math.round(seconds / 3600);
  if (minutes < 90) return `${minutes} min`;
  if (minutes < 48 * 60) return `${Math.floor(minutes / 60)} h` + (minutes % 60 ? ` ${minutes % 60} min` : "");
  return `${Math.floor(hours / 24)} days` + (hours % 24 ? ` ${hours % 24} h` : "");
}

// How many in an hour, the twin of `rate` in progress.py; fewer than one is told by the time that it takes.
function rate(perHour) {
  if (perHour < 1) return `one in ${duration(3600 / perHour)}`;
  return `${perHour < 9.95 ? perHour.toFixed(1) : count(Math.round(perHour))} an hour`;
}

// A time of the manifest, which is UTC, on the clock of whoever looks.
const clock = new Intl.DateTimeFormat("en-GB", { dateStyle: "medium", timeStyle: "short" });
const moment = (date) => clock.format(Date.parse(date));
const utc = (date) => date.replace("T", " ").replace(/Z$/, " UTC");

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

// How a batch stands: `words`, and where nobody works at what is left the `command` that goes on; null where nothing is left.
// `states`: how many are in each. `now`: ms.
const SILENT = 15 * 60;  // seconds without a sign of life, which is given every few seconds, or minutes for 100,000 materials
function standing(states, library, now) {
  const all = Object.values(states).reduce((a, b) => a + b, 0), left = states.running + states.pending;
  if (!left) return null;
  const { per_hour, left_seconds } = library.progress ?? {}, silent = (now - Date.parse(library.made)) / 1000;
  const share = `${count(all - left)} of ${count(all)} ended, ${Math.floor(100 * (all - left) / all)} %`;
  const command = library.command ?? `mitsvbrdf batch … -o ${library.title}`;
  if (library.stopped || !library.progress)
    return { words: `${share} · stopped, ${count(left)} left; run the same command to go on:`, command };
  if (silent > SILENT)
    return { words: `${share} · no sign of life for ${duration(silent)}; if it died, the same command goes on:`, command };
  const first = states.running ? `the first ${states.running > 1 ? "fits are" : "fit is"} running` : "workers are starting";
  const speed = left_seconds == null ? [] : [`this run: ${rate(per_hour)}, about ${duration(left_seconds)} left`];
  return { words: [share, ...per_hour ? speed : [first]].join(" · "), command: null };
}

// What tells rows of one name apart, a few words each: folders of their sources, then options and so on as far as needed.
function apart(rows) {
  const kinds = [sourcesApart, each((row) => row.options || "default options"), each((row) => row.method),
    each((row) => `${row.resolution} px`), each((row) => row.date && moment(row.date)), each((row) => row.id)];
  let words = rows.map(() => ""), told = 1;
  for (const kind of kinds) {
    if (told === rows.length) break;
    const more = kind(rows), joined = words.map((before, i) => [before, more[i]].filter(Boolean).join(" · "));
    const tells = new Set(joined).size;
    if (tells > told) [words, told] = [joined, tells];
  }
  return words;
}
const each = (part) => (rows) => rows.map(part);

// Of each path what lies between the folders that all begin with and those that all end with.
function sourcesApart(rows) {
  const paths = rows.map((row) => (row.source ?? "").split("/")), shortest = Math.min(...paths.map((path) => path.length));
  const alike = (at) => paths.every((path) => path.at(at) === paths[0].at(at));
  let head = 0, tail = 0;
  while (head < shortest && alike(head)) head++;
  while (head + tail < shortest && alike(-1 - tail)) tail++;
  return paths.map((path) => path.slice(head, path.length - tail).join("/"));
}

// Round numbers for a logarithmic axis, from the last one below `low` to the first one above `high`: of 1, 2, 5, 10, ..., or
// powers of ten alone where those would be many.
const MANY = 7;
function ticks(low, high, steps = [1, 2, 5]) {
  const n = steps.length, at = (k) => Number(`${steps[((k % n) + n) % n]}e${Math.floor(k / n)}`);
  let first = n * Math.floor(Math.log10(low)) + n - 1, last = first;
  while (at(first) > low) first--;
  while (at(last) < high || last === first) last++;
  if (last - first >= MANY && n > 1) return ticks(low, high, [1]);
  return Array.from({ length: last - first + 1 }, (_, k) => at(first + k));
}

// The errors of the materials shown in a sentence, few of them one by one. They ascend.
const FEW = 10;
function spread(errors) {
  if (!errors.length) return "None of the materials shown has an error.";
  const of = `Error of the ${several(errors.length, "material")} shown`;
  if (errors.length < FEW) return `${of}: ${Array.from(errors, (error) => number(error)).join(", ")}.`;
  const reached = (part) => number(errors[Math.ceil(part * errors.length) - 1]);
  return `${of}: half have ${reached(0.5)} or less, 9 of 10 have ${reached(0.9)} or less.`;
}
