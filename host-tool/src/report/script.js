// Zoom, pan, reading off values, hiding lines and downloads for the plots of a report. The drawings are whole without it.
'use strict';
(() => {
  const SVG = 'http://www.w3.org/2000/svg';
  const element = (name, attributes, parent) => {
    const made = document.createElementNS(SVG, name);
    for (const key in attributes) made.setAttribute(key, attributes[key]);
    if (parent) parent.appendChild(made);
    return made;
  };
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
  const short = (value) => (value === null ? '–' : String(Number(value.toPrecision(5))));
  const unit = (label) => (label.includes(' / ') ? ' ' + label.split(' / ').pop() : '');

  // Round numbers between two ends, about so many.
  const ticks = (low, high, count) => {
    const rough = (high - low) / count;
    const decade = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 2.5, 5, 10].map((factor) => factor * decade).find((one) => one >= 0.999 * rough);
    const found = [];
    for (let index = Math.ceil(low / step); index * step <= high && found.length < 50; index++) found.push(index * step);
    return found.map((value) => [value, Math.abs(value) < 1e-9 * step ? '0' : String(Number(value.toPrecision(10)))]);
  };

  // One, two and five times each power of ten between two powers; over many decades the powers alone.
  const decades = (low, high) => {
    const raised = (power) => '10' + [...String(power)].map((letter) => '⁰¹²³⁴⁵⁶⁷⁸⁹'[letter] || '⁻').join('');
    const found = [];
    for (let power = Math.floor(low); power <= high; power++) {
      for (const times of high - low < 2.5 ? [1, 2, 5] : [1]) {
        const value = times * 10 ** power;
        const at = Math.log10(value);
        if (at >= low && at <= high) found.push([value, times === 1 ? raised(power) : String(Number(value.toPrecision(3)))]);
      }
    }
    return found;
  };

  class Plot {
    constructor(figure, node, described) {
      Object.assign(this, described);
      this.figure = figure;
      [this.left, this.right, this.top, this.bottom] = this.frame;
      this.whole = { x: this.x, y: this.y };
      this.ticksNode = node.querySelector('.ticks');
      this.drawn = [...node.querySelectorAll('.series')].map((group) => ({ node: group, was: group.innerHTML }));
      this.wasTicks = this.ticksNode.innerHTML;
      this.zeros = node.querySelector('.zeros');
      const clip = element('clipPath', { id: `${figure.id}-${figure.plots.length}` }, node);
      const box = { x: this.left, y: this.top, width: this.right - this.left, height: this.bottom - this.top };
      element('rect', box, clip);
      const parts = this.zeros ? [this.zeros, ...this.drawn.map((one) => one.node)] : this.drawn.map((one) => one.node);
      for (const part of parts) part.setAttribute('clip-path', `url(#${clip.id})`);
      this.hair = element('path', { class: 'hair' }, node);
      this.mark = element('circle', { class: 'mark', r: 4, cx: -99, cy: -99 }, node);
      this.chosen = element('rect', { class: 'chosen-range', y: this.top, height: box.height, width: 0 }, node);
      this.surface = element('rect', { class: 'surface', fill: 'transparent', ...box }, node);
    }

    column(line, axis) { return this.figure.group.tables[line.t][line[axis]]; }
    atX(value) { return this.left + (value - this.x[0]) / (this.x[1] - this.x[0]) * (this.right - this.left); }
    // The place of a value on the vertical axis, which may be logarithmic.
    level(value) { return this.log ? Math.log10(Math.max(value, 1e-300)) : value; }
    atY(value) { return this.bottom - (this.level(value) - this.y[0]) / (this.y[1] - this.y[0]) * (this.bottom - this.top); }
    ofX(at) { return this.x[0] + (at - this.left) / (this.right - this.left) * (this.x[1] - this.x[0]); }
    // A line over rising values, as time, and no loop.
    isOverTime() { return this.xl.startsWith('time') || this.xl.includes('steps'); }

    // Draws what the numbers hold; `rows` are those that lie within the time that is shown, where the group has one.
    draw(rows) {
      const isWhole = this.x === this.whole.x && !rows;
      if (isWhole) {
        this.y = this.whole.y;
        this.ticksNode.innerHTML = this.wasTicks;
        for (const one of this.drawn) one.node.innerHTML = one.was;
      } else {
        if (this.isOverTime()) this.fit();
        this.s.forEach((line, number) => { this.drawn[number].node.innerHTML = this.path(line, rows); });
        this.drawTicks();
      }
      if (this.zeros) {
        const at = this.atY(0);
        this.zeros.innerHTML = `<path class="zero" d="M${this.left} ${at}L${this.right} ${at}"/>`;
      }
    }

    // The vertical axis for what is seen.
    fit() {
      let low = Infinity;
      let high = -Infinity;
      for (const line of this.s) {
        if (this.figure.group.hidden.has(line.n)) continue;
        const [x, y] = [this.column(line, 'x'), this.column(line, 'y')];
        for (let row = 0; row < x.length; row++) {
          if (y[row] === null || x[row] < this.x[0] || x[row] > this.x[1]) continue;
          if (this.log && y[row] <= 0) continue;
          low = Math.min(low, this.level(y[row]));
          high = Math.max(high, this.level(y[row]));
        }
      }
      if (low > high) return;
      if (this.zeros) [low, high] = [Math.min(low, 0), Math.max(high, 0)];
      const room = 0.06 * (high - low || Math.abs(high) || 1);
      this.y = [low - room, high + room];
    }

    path(line, rows) {
      const [x, y] = [this.column(line, 'x'), this.column(line, 'y')];
      let [first, last] = [0, x.length - 1];
      if (rows && rows.t === line.t) [first, last] = [rows.first, rows.last];
      let text = '';
      let down = false;
      for (let row = first; row <= last; row++) {
        if (x[row] === null || y[row] === null) { down = false; continue; }
        text += `${down ? 'L' : 'M'}${this.atX(x[row]).toFixed(1)} ${this.atY(y[row]).toFixed(1)}`;
        down = true;
      }
      return `<path class="${line.c}" d="${text}"/>`;
    }

    drawTicks() {
      const below = this.ticksNode.classList.contains('below');
      let text = '';
      const levels = this.log ? decades(this.y[0], this.y[1]) : ticks(this.y[0], this.y[1], this.bottom - this.top < 110 ? 3 : 5);
      for (const [value, label] of levels) {
        const at = this.atY(value).toFixed(1);
        text += `<path class="grid" d="M${this.left} ${at}L${this.right} ${at}"/>`;
        text += `<text class="tick" x="${this.left - 8}" y="${Number(at) + 4}" text-anchor="end">${label}</text>`;
      }
      for (const [value, label] of ticks(this.x[0], this.x[1], this.right - this.left > 400 ? 8 : 5)) {
        const at = this.atX(value).toFixed(1);
        text += `<path class="grid" d="M${at} ${this.top}L${at} ${this.bottom}"/>`;
        if (below) text += `<text class="tick" x="${at}" y="${this.bottom + 17}" text-anchor="middle">${label}</text>`;
      }
      this.ticksNode.innerHTML = text;
    }

    // The row next to a place in the drawing, of the first line that is seen.
    nearest(at) {
      const line = this.s.find((one) => !this.figure.group.hidden.has(one.n));
      if (!line) return null;
      const [x, y] = [this.column(line, 'x'), this.column(line, 'y')];
      let [best, least] = [-1, Infinity];
      for (let row = 0; row < x.length; row++) {
        if (x[row] === null || y[row] === null) continue;
        const across = this.atX(x[row]) - at.x;
        const up = this.isOverTime() ? 0 : this.atY(y[row]) - at.y;
        const distance = across * across + up * up;
        if (distance < least) [best, least] = [row, distance];
      }
      return best < 0 ? null : { t: line.t, row: best };
    }

    // Marks a row; gives what stands there.
    point(place) {
      const line = place && this.s.find((one) => one.t === place.t && !this.figure.group.hidden.has(one.n));
      const x = line ? this.column(line, 'x')[place.row] : null;
      const y = line ? this.column(line, 'y')[place.row] : null;
      const seen = x !== null && y !== null && x >= this.x[0] && x <= this.x[1];
      const [atX, atY] = seen ? [this.atX(x), this.atY(y)] : [-99, -99];
      this.hair.setAttribute('d', seen && this.isOverTime() ? `M${atX} ${this.top}L${atX} ${this.bottom}` : '');
      this.mark.setAttribute('cx', atX);
      this.mark.setAttribute('cy', clamp(atY, -99, this.bottom));
      if (!line) return [];
      const values = this.s.filter((one) => one.t === place.t && !this.figure.group.hidden.has(one.n));
      const named = values.map((one) => `${one.n || this.yl.split(' / ')[0]} ${short(this.column(one, 'y')[place.row])}${unit(this.yl)}`);
      return [`${this.xl.split(' / ')[0]} ${short(x)}${unit(this.xl)}`, ...named];
    }
  }

  class Figure {
    constructor(group, described) {
      this.group = group;
      this.id = described.id;
      this.svg = document.getElementById(this.id);
      this.plots = [];
      this.svg.querySelectorAll('.plot').forEach((node, number) => {
        this.plots.push(new Plot(this, node, described.plots[number]));
      });
      this.bar();
      this.plots.forEach((plot) => this.listen(plot));
      this.svg.querySelectorAll('.entry').forEach((entry) => this.entry(entry));
    }

    // The line of buttons below the drawing.
    bar() {
      const bar = document.createElement('div');
      bar.className = 'tools';
      const button = (text, title, act) => {
        const made = document.createElement('button');
        Object.assign(made, { type: 'button', textContent: text, title, onclick: act });
        made.setAttribute('aria-label', title);
        bar.appendChild(made);
      };
      const title = this.svg.querySelector('title').textContent;
      if (this.plots.some((plot) => plot.isOverTime())) {
        button('+', 'Zoom in', () => this.scale(0.5));
        button('−', 'Zoom out', () => this.scale(2));
        button('◀', 'Earlier', () => this.move(-0.25));
        button('▶', 'Later', () => this.move(0.25));
        button('Whole', 'Show the whole of it', () => this.group.show(null));
      }
      button('SVG', `Download “${title}” as SVG`, () => this.save('svg', this.markup(), 'image/svg+xml'));
      button('PNG', `Download “${title}” as PNG`, () => this.picture());
      button('CSV', `Download the numbers of “${title}” as CSV`, () => this.save('csv', this.csv(), 'text/csv'));
      this.readout = document.createElement('output');
      bar.appendChild(this.readout);
      this.svg.after(bar);
    }

    overTime() { return this.plots.find((plot) => plot.isOverTime()); }
    scale(factor) {
      const [low, high] = this.overTime().x;
      const half = 0.5 * factor * (high - low);
      this.group.show([0.5 * (low + high) - half, 0.5 * (low + high) + half]);
    }
    move(share) {
      const [low, high] = this.overTime().x;
      this.group.show([low + share * (high - low), high + share * (high - low)]);
    }

    place(event) {
      const box = this.svg.getBoundingClientRect();
      const [, , width, height] = this.svg.getAttribute('viewBox').split(' ').map(Number);
      return { x: (event.clientX - box.left) / box.width * width, y: (event.clientY - box.top) / box.height * height };
    }

    // A drag across chooses a range, with Shift it moves what is seen; a double click shows the whole.
    listen(plot) {
      let from = null;
      const surface = plot.surface;
      surface.addEventListener('pointermove', (event) => {
        const at = this.place(event);
        this.group.point(plot.nearest(at));
        if (!from) return;
        if (from.moves) {
          const shift = (from.x - at.x) / (plot.right - plot.left) * (from.range[1] - from.range[0]);
          this.group.show([from.range[0] + shift, from.range[1] + shift]);
          return;
        }
        const [low, high] = [from.x, at.x].sort((one, other) => one - other).map((x) => clamp(x, plot.left, plot.right));
        plot.chosen.setAttribute('x', low);
        plot.chosen.setAttribute('width', high - low);
      });
      surface.addEventListener('pointerleave', () => this.group.point(null));
      surface.addEventListener('dblclick', () => this.group.show(null));
      if (!plot.isOverTime()) return;
      surface.classList.add('can-zoom');
      surface.addEventListener('pointerdown', (event) => {
        if (event.button !== 0) return;
        from = { ...this.place(event), moves: event.shiftKey, range: plot.x };
        surface.setPointerCapture(event.pointerId);
      });
      const end = (event) => {
        if (!from) return;
        const [begin, at] = [from, this.place(event)];
        from = null;
        plot.chosen.setAttribute('width', 0);
        if (event.type === 'pointercancel' || begin.moves || Math.abs(at.x - begin.x) < 5) return;
        const range = [begin.x, at.x].sort((one, other) => one - other).map((x) => plot.ofX(clamp(x, plot.left, plot.right)));
        this.group.show(range);
      };
      surface.addEventListener('pointerup', end);
      surface.addEventListener('pointercancel', end);
    }

    entry(node) {
      const name = node.dataset.n;
      const toggle = () => this.group.toggle(name);
      node.setAttribute('role', 'button');
      node.setAttribute('tabindex', '0');
      node.setAttribute('aria-pressed', 'true');
      node.addEventListener('click', toggle);
      node.addEventListener('keydown', (event) => {
        if (event.key === 'Enter' || event.key === ' ') { event.preventDefault(); toggle(); }
      });
    }

    // The drawing with the page's colours in it, for a file of its own.
    markup() {
      const copy = this.svg.cloneNode(true);
      const wanted = ['fill', 'stroke', 'stroke-width', 'stroke-dasharray', 'opacity', 'display', 'font-family', 'font-size', 'font-weight'];
      const [own, made] = [this.svg.querySelectorAll('*'), copy.querySelectorAll('*')];
      own.forEach((node, number) => {
        const style = getComputedStyle(node);
        made[number].setAttribute('style', wanted.map((name) => `${name}:${style.getPropertyValue(name)}`).join(';'));
      });
      const [, , width, height] = this.svg.getAttribute('viewBox').split(' ').map(Number);
      const paper = element('rect', { width, height, fill: getComputedStyle(this.svg.closest('figure')).backgroundColor });
      copy.insertBefore(paper, copy.firstChild);
      copy.setAttribute('width', width);
      copy.setAttribute('height', height);
      copy.querySelectorAll('.surface,.hair,.mark,.chosen-range').forEach((node) => node.remove());
      return new XMLSerializer().serializeToString(copy);
    }

    picture() {
      const image = new Image();
      image.onload = () => {
        const canvas = document.createElement('canvas');
        [canvas.width, canvas.height] = [2 * image.width, 2 * image.height];
        canvas.getContext('2d').drawImage(image, 0, 0, canvas.width, canvas.height);
        canvas.toBlob((blob) => this.offer('png', blob));
      };
      image.src = 'data:image/svg+xml;charset=utf-8,' + encodeURIComponent(this.markup());
    }

    // The numbers, a block of columns for each table that the plots use.
    csv() {
      const quoted = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
      const blocks = new Map();
      for (const plot of this.plots) {
        for (const line of plot.s) {
          const block = blocks.get(line.t) || blocks.set(line.t, new Map()).get(line.t);
          // Two quantities may have the same numbers.
          const add = (column, name) => block.set(`${column} ${name}`, [column, name]);
          add(line.x, plot.xl);
          const [quantity, ...of] = plot.yl.split(' / ');
          const name = line.n ? `${quantity}, ${line.n}` : quantity;
          add(line.y, [name, ...of].join(' / '));
        }
      }
      return [...blocks].map(([table, columns]) => {
        const numbers = [...columns.values()].map(([column]) => this.group.tables[table][column]);
        const rows = numbers[0].map((_, row) => numbers.map((column) => column[row] ?? '').join(','));
        return [[...columns.values()].map(([, name]) => quoted(name)).join(','), ...rows].join('\n') + '\n';
      }).join('\n');
    }

    save(ending, text, type) { this.offer(ending, new Blob([text], { type })); }
    offer(ending, blob) {
      const link = document.createElement('a');
      const name = this.svg.querySelector('title').textContent.replace(/[^\p{L}\p{N}.-]+/gu, '-').replace(/^-|-$/g, '');
      [link.href, link.download] = [URL.createObjectURL(blob), `${name}.${ending}`];
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    }
  }

  // Figures that belong together: one range of time, one sample pointed at, the same lines hidden.
  class Group {
    constructor(described) {
      this.tables = described.tables;
      this.hidden = new Set();
      this.figures = [];
      for (const one of described.figures) this.figures.push(new Figure(this, one));
    }

    plots() { return this.figures.flatMap((figure) => figure.plots); }

    // Shows a range of the horizontal axis of what is drawn over time; loops show the samples of that time. Nothing shows the whole.
    show(range) {
      this.range = range;
      const overTime = this.plots().filter((plot) => plot.isOverTime());
      for (const plot of overTime) {
        const [low, high] = plot.whole.x;
        const span = range && Math.max(range[1] - range[0], 1e-4 * (high - low));
        const begin = range && clamp(range[0], low, Math.max(high - span, low));
        plot.x = !range || span >= high - low ? plot.whole.x : [begin, begin + span];
        plot.draw(null);
      }
      for (const plot of this.plots().filter((plot) => !plot.isOverTime())) plot.draw(this.rows(overTime, plot));
    }

    // The rows of a loop's table in the time that is shown; nothing for all of them.
    rows(overTime, loop) {
      const guide = overTime.find((plot) => plot.x !== plot.whole.x);
      const line = guide && guide.s.find((one) => loop.s.some((other) => other.t === one.t));
      if (!line) return null;
      const time = guide.column(line, 'x');
      const first = time.findIndex((value) => value >= guide.x[0]);
      const last = time.findLastIndex((value) => value !== null && value <= guide.x[1]);
      return first < 0 || last < first ? null : { t: line.t, first, last };
    }

    point(place) {
      for (const figure of this.figures) {
        const said = figure.plots.flatMap((plot) => plot.point(place));
        figure.readout.textContent = [...new Set(said)].join(' · ');
      }
    }

    toggle(name) {
      if (!this.hidden.delete(name)) this.hidden.add(name);
      for (const figure of this.figures) {
        figure.svg.querySelectorAll('.entry').forEach((entry) => {
          const isHidden = this.hidden.has(entry.dataset.n);
          entry.classList.toggle('hidden', isHidden);
          entry.setAttribute('aria-pressed', String(!isHidden));
        });
        for (const plot of figure.plots) {
          plot.s.forEach((line, number) => plot.drawn[number].node.classList.toggle('hidden', this.hidden.has(line.n)));
        }
      }
      if (this.range) this.show(this.range);
    }
  }

  document.querySelectorAll('script[type="application/json"]').forEach((node) => new Group(JSON.parse(node.textContent)));
})();
