// What stands above the cards: counts and times, the spread of the error, how a batch stands.

function make(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) if (value !== null) element.setAttribute(key, value);
  element.append(...children);  // strings become text, never tags
  return element;
}

function pairs(values) {
  return values.filter(([, value]) => value != null && value !== "")
    .flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value instanceof Node ? value : String(value))]);
}

// A time of the manifest on the clock of whoever looks; which moment it is all over the world appears under the pointer.
function moments(date) {
  return date ? make("time", { datetime: date, title: utc(date) }, moment(date)) : null;
}

function showNumbers(element, rows, atWork) {
  const seconds = rows.reduce((sum, row) => sum + (row.seconds ?? 0), 0), hourly = atWork ? null : perHour(rows);
  const values = [["Materials", rows.length && count(rows.length)], ["Time of all fits", seconds && duration(seconds)],
    ["Speed of all runs", hourly && rate(hourly)]];
  element.replaceChildren(...values.filter(([, value]) => value).map((pair) => make("div", {}, ...pairs([pair]))));
}

function showProgress(section, states, stands) {
  section.hidden = !stands;
  if (section.hidden) return;
  const [bar, text, command] = section.children, all = Object.values(states).reduce((a, b) => a + b, 0);
  bar.setAttribute("aria-label", Object.entries(states).map(([state, n]) => `${count(n)} ${state}`).join(", "));
  bar.replaceChildren(...Object.entries(states).map(([state, n]) => {
    const part = make("i", { class: state });
    part.style.width = `${100 * n / all}%`;
    return part;
  }));
  text.textContent = stands.words;
  command.hidden = !stands.command;
  command.textContent = stands.command ?? "";
}

// How often each error occurs: of all materials, and on top of it of those shown. Few are told one by one.
const BINS = 48;  // at most: as many as three cube roots of what is counted
function showErrors(figure, all, shown) {
  const [plot, caption] = figure.children, [top, svg, axis] = plot.children;
  const values = (rows) => Float64Array.from(rows.map((row) => row.error).filter((error) => error > 0)).sort();
  const every = all.errors ??= values(all), some = shown.length === all.length ? every : values(shown);
  figure.hidden = !every.length;
  plot.hidden = every.length < FEW;
  caption.textContent = spread(some);
  if (plot.hidden) return;
  const marks = ticks(every[0], every.at(-1)), low = Math.log10(marks[0]), span = Math.log10(marks.at(-1)) - low;
  const wide = Math.min(BINS, Math.ceil(3 * Math.cbrt(every.length)));
  const share = (error) => (Math.log10(error) - low) / span;
  const bins = (errors) => {
    const found = new Uint32Array(wide);
    for (const error of errors) found[Math.min(wide - 1, Math.floor(share(error) * wide))]++;
    return found;
  };
  const heights = bins(every), most = Math.max(...heights);
  const bar = (n, k) => n && `M${k + 0.05} 100v-${Math.max(1, 100 * n / most).toFixed(1)}h.9V100z`;
  svg.setAttribute("viewBox", `0 0 ${wide} 100`);
  const bars = (numbers, kind) => {
    const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
    path.setAttribute("class", kind);
    path.setAttribute("d", Array.from(numbers, bar).filter(Boolean).join(""));
    return path;
  };
  top.textContent = several(most, "material");
  svg.replaceChildren(bars(heights, "all"), bars(bins(some), "shown"));
  svg.setAttribute("aria-label", `${caption.textContent} All lie from ${number(every[0])} to ${number(every.at(-1))}.`);
  axis.replaceChildren(...marks.map((mark) => {
    const text = make("span", {}, number(mark));
    text.style.left = `${100 * share(mark)}%`;
    return text;
  }));
}
