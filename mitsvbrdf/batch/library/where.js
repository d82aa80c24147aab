// Which materials are meant: the twin of where.py, which says what an expression may hold. Here, too, errors are thrown with
// expected, got and the way out in one line.

const SPACE = " \\t\\n\\r\\f\\v\\u00a0";
const TERM = new RegExp(`(?:"(?:[^"]|"")*"|[^${SPACE}"])+`, "g");
const PART = /(?:"(?:[^"]|"")*"|[^,"])+/g;
const COMPARISON = /^([A-Za-z_]+)(<=|>=|[<>=:])([\s\S]*)$/;
const NUMBER = /^[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?$/;
const DATE = /^[0-9]{4}(-[0-9]{2}(-[0-9]{2}(T[0-9]{2}(:[0-9]{2}(:[0-9]{2})?)?)?)?)?$/;
const COMPARE = {
  "<": (a, b) => a < b, "<=": (a, b) => a <= b, ">": (a, b) => a > b, ">=": (a, b) => a >= b,
  "=": (a, b) => a === b, ":": (a, b) => a === b,
};

// A test whether a row is meant. `where` is {fields, states, searched} as page.py gives it.
function matcher(where, text) {
  if (text.split('"').length % 2 === 0) refuse('a " at the end too', text, 'quote as in tag:"old wood"');
  const tests = termsOf(text).map((term) => testOf(where, term));
  return (row) => tests.every((test) => test(row));
}

function termsOf(text) {
  return text.match(TERM) ?? [];
}

// The term that asks for a value, quoted where it needs to be.
function termFor(field, value) {
  return field + ":" + (/^[^\s",]+$/.test(value) ? value : `"${value.replaceAll('"', '""')}"`);
}

// The value of a number field; null where it is missing.
function numberOf(row, field) {
  if (field === "warnings") return row.warnings?.length ?? 0;
  if (field === "memory") return row.peak_bytes == null ? null : row.peak_bytes / 2 ** 30;
  return row[field] ?? null;
}

function testOf(where, term) {
  const found = COMPARISON.exec(term);
  if (!found) {
    const word = folded(unquoted(term));
    return (row) => searchedIn(where, row).includes(word);
  }
  const [field, compare, value] = [found[1].toLowerCase(), found[2], found[3]];
  if (!Object.hasOwn(where.fields, field))
    refuse("one of " + Object.keys(where.fields).join(", "), field,
      `${nearest(Object.keys(where.fields), field)} is the nearest; write "${term}" in quotes to search for it as text`);
  const { kind, example } = where.fields[field];
  if (["choice", "text"].includes(kind) && !":=".includes(compare))
    refuse(`${field}: or ${field}=`, field + compare, `write as in ${example}`);
  if (!unquoted(value)) refuse(`a value after ${field}${compare}`, "none", `write as in ${example}`);
  if (kind === "choice") return choiceTest(where, field, wordsOf(value));
  if (kind === "text") return textTest(field, compare, wordsOf(value));
  return (kind === "number" ? numberTest : dateTest)(field, compare, unquoted(value), example);
}

// The field that the fewest changes of a letter make of a word; of several the first.
function nearest(fields, word) {
  const changes = (field) => {
    const row = Array.from({ length: field.length + 1 }, (_, k) => k);
    for (let i = 1; i <= word.length; i++) {
      let diagonal = row[0];
      row[0] = i;
      for (let k = 1; k <= field.length; k++) {
        const best = Math.min(row[k] + 1, row[k - 1] + 1, diagonal + (word[i - 1] !== field[k - 1]));
        [diagonal, row[k]] = [row[k], best];
      }
    }
    return row[field.length];
  };
  return fields.reduce((best, field) => changes(field) < changes(best) ? field : best);
}

function numberTest(field, compare, value, example) {
  if (!NUMBER.test(value)) refuse(`a number after ${field}${compare}`, value, `write as in ${example}`);
  const limit = Number(value), holds = COMPARE[compare];
  return (row) => {
    const number = numberOf(row, field);
    return number !== null && holds(number, limit);
  };
}

function dateTest(field, compare, value, example) {
  if (!DATE.test(value)) refuse(`a date after date${compare}`, value, `write as in ${example}`);
  const holds = COMPARE[compare];
  return (row) => Boolean(row.date) && holds(row.date.slice(0, value.length), value);
}

// The words that commas stand between; a comma in quotes is a part of its word.
function wordsOf(value) {
  return (value.match(PART) ?? []).map((part) => folded(unquoted(part))).filter(Boolean);
}

function choiceTest(where, field, words) {
  const unknown = field === "state" && words.filter((word) => !where.states.includes(word)).sort()[0];
  if (unknown) refuse("done, failed, running or pending", unknown, "write as in state:failed");
  if (field === "tag") return (row) => (row.tags ?? []).some((tag) => words.includes(folded(tag)));
  return (row) => words.includes(textOf(row, field));
}

function textTest(field, compare, words) {
  if (compare === "=") return (row) => words.includes(textOf(row, field));
  return (row) => words.some((word) => textOf(row, field).includes(word));
}

// Upper and lower case are the same, and so are a space and _, which names have in its place.
function folded(text) {
  return text.toLowerCase().replaceAll("_", " ");
}

function unquoted(text) {
  return text.replace(/"((?:[^"]|"")*)"/g, (all, inside) => inside.replaceAll('""', '"'));
}

function textOf(row, field) {
  return folded(row[field] ?? "");
}

// What a word is looked for in; kept with the row, for each letter typed asks for it again.
const SEARCHED = Symbol("searched");
function searchedIn(where, row) {
  return row[SEARCHED] ??= folded([...where.searched.map((name) => row[name] ?? ""), ...(row.tags ?? [])].join("\n"));
}

function refuse(expected, got, fix) {
  throw new RangeError(`expected ${expected}, got ${got}; ${fix}`);
}
