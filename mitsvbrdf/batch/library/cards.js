// Cards in a grid, of which only those near the window are in the page: the list has the height of all, each card its place.

const REST = 60;  // ms until the pictures of new cards are asked for; cards that fly past ask for none

class Cards {
  // `list`: the element; `makeCard(row)`: an <li>; a card stays as it is while its row's `stampOf(row)` is the same.
  constructor(list, makeCard, stampOf) {
    Object.assign(this, { list, makeCard, stampOf, rows: [], cards: new Map(), frame: 0, timer: 0, drawnAt: 0, width: 0 });
    addEventListener("scroll", () => this.later(), { passive: true });
    addEventListener("resize", () => this.later());
    list.addEventListener("focusin", () => this.draw());
    new ResizeObserver(() => this.resized()).observe(list);
    this.measure();
  }

  // What draw() shows from now on.
  set(rows) {
    this.rows = rows;
    this.measure();
  }

  measure() {
    const rem = parseFloat(getComputedStyle(document.documentElement).fontSize), list = this.list;
    const text = parseFloat(getComputedStyle(list).getPropertyValue("--text"));  // rem below a card's picture
    this.gap = Math.round(0.75 * rem);
    this.width = list.clientWidth;
    this.columns = Math.max(2, Math.floor((this.width + this.gap) / (10 * rem + this.gap)));
    this.side = Math.floor((this.width - this.gap * (this.columns - 1)) / this.columns);
    this.step = this.side + Math.round(text * rem) + this.gap;  // from one line of cards to the next
    list.style.setProperty("--side", this.side + "px");
    list.style.height = Math.ceil(this.rows.length / this.columns) * this.step + "px";
  }

  resized() {
    if (this.list.clientWidth === this.width) return;
    const place = this.place();
    this.measure();
    this.go(place);
    this.draw(true);
  }

  later() {
    this.frame ||= requestAnimationFrame(() => this.draw());
  }

  // Put the cards of the window, and of half a window above and below, into the page.
  draw(anew = false) {
    this.frame = 0;
    const top = this.list.getBoundingClientRect().top, { columns, step, rows, cards } = this;
    const line = (y) => Math.max(0, Math.floor((y - top) / step));
    let first = line(-0.5 * innerHeight) * columns, last = (line(1.5 * innerHeight) + 1) * columns;
    const focused = document.activeElement?.closest("#cards > li")?.place ?? -1;
    if (focused >= first - columns && focused < last + columns) {  // its neighbours are there for the Tab key
      first = Math.min(first, Math.max(0, focused - columns));
      last = Math.max(last, focused + columns + 1);
    }
    last = Math.min(rows.length, last);
    if (!anew && first === this.first && last === this.last) return;
    [this.first, this.last] = [first, last];
    const near = new Map();
    for (let i = first; i < last; i++) near.set(this.stampOf(rows[i]), i);
    for (const [stamp, card] of cards) {
      if (near.has(stamp) || !anew && card.contains(document.activeElement)) continue;
      card.querySelector("img")?.removeAttribute("src");  // ends a request that is under way
      card.remove();
      cards.delete(stamp);
    }
    let next = this.list.firstChild;
    for (const [stamp, i] of near) {
      let card = cards.get(stamp);
      if (!card) cards.set(stamp, card = Object.assign(this.makeCard(rows[i]), { stamp }));
      while (next && !near.has(next.stamp) && next.place < i) next = next.nextSibling;  // a focused one that is far away
      if (card === next) next = next.nextSibling;
      else this.list.insertBefore(card, next);
      this.put(card, i);
    }
    this.askForPictures(anew);
  }

  put(card, i) {
    const x = (i % this.columns) * (this.side + this.gap), y = Math.floor(i / this.columns) * this.step;
    card.place = i;
    card.style.transform = `translate(${x}px, ${y}px)`;
    card.setAttribute("aria-posinset", i + 1);
    card.setAttribute("aria-setsize", this.rows.length);
  }

  askForPictures(now) {
    const ask = () => {
      this.timer = 0;
      const moved = Math.abs(scrollY - this.drawnAt);
      this.drawnAt = scrollY;
      if (moved > innerHeight / 2) return this.askForPictures(false);
      for (const image of this.list.querySelectorAll("img[data-src]")) {
        image.src = image.dataset.src;
        delete image.dataset.src;
      }
    };
    if (now) {
      this.drawnAt = scrollY;
      ask();
    } else this.timer ||= setTimeout(ask, REST);
  }

  // Where the window is: the row at its top left and how many pixels above the window that begins; null above the list.
  place() {
    const down = -this.list.getBoundingClientRect().top, line = Math.floor(down / this.step);
    const row = this.rows[line * this.columns];
    return down > 0 && row ? { key: row.key, above: Math.round(down - line * this.step) } : null;
  }

  go(place) {
    const i = place ? this.rows.findIndex((row) => row.key === place.key) : -1;
    if (i < 0) return false;
    const top = this.list.getBoundingClientRect().top + scrollY;
    scrollTo(0, top + Math.floor(i / this.columns) * this.step + Math.min(place.above, this.step - 1));
    return true;
  }
}
