/* Curves over time on canvases: drawn once for each run; the cursor lies above as an element of its own. */
'use strict';

const LEFT = 52, RIGHT = 10;

/* Colours and font of the theme: asked for once, because each question makes the browser lay out the page. */
let palette = {};

function newPalette() {
  palette = { font: '12px ' + getComputedStyle(document.body).fontFamily };
}

function colour(name) {
  if (!(name in palette)) palette[name] = getComputedStyle(document.documentElement).getPropertyValue('--' + name).trim();
  return palette[name];
}

/* Opaque: what lies on top of nothing is cheaper to put on the screen. */
function opaque(canvas, width, height, ratio) {
  const c = canvas.getContext('2d', { alpha: false });
  c.setTransform(ratio, 0, 0, ratio, 0, 0);
  c.fillStyle = colour('card');
  c.fillRect(0, 0, width, height);
  c.font = palette.font;
  return c;
}

/* Texts are set where they change: each that is set lays the page out anew. `again`: also where they do not, so that
 * screen readers say them. */
function put(element, text, again) {
  if (again || element.textContent !== text) element.textContent = text;
}

function niceStep(range, most) {
  const raw = range / most, power = 10 ** Math.floor(Math.log10(raw)), m = raw / power;
  return power * (m <= 1 ? 1 : m <= 2 ? 2 : m <= 2.5 ? 2.5 : m <= 5 ? 5 : 10);
}

function tickText(x, step) {
  let places = 0;
  while (places < 6 && Math.abs(step * 10 ** places - Math.round(step * 10 ** places)) > 1e-6) ++places;
  return digits(Math.abs(x) < step * 1e-6 ? 0 : x, places);
}

class Plot {
  constructor(host, { title, height, zero, symmetric }) {
    this.height = height;
    this.zero = zero;
    this.symmetric = symmetric;
    this.range = null;
    this.element = document.createElement('figure');
    this.element.innerHTML = '<figcaption><span class="name"></span> <output></output><span class="aside"></span></figcaption>';
    this.canvas = document.createElement('canvas');
    this.canvas.setAttribute('role', 'img');
    this.element.append(this.canvas);
    this.element.querySelector('.name').textContent = title;
    this.reading = this.element.querySelector('output');
    this.aside = this.element.querySelector('.aside');
    this.title = title;
    host.append(this.element);
  }

  rename(title) {
    if (title === this.title) return;
    this.title = title;
    this.element.querySelector('.name').textContent = title;
  }

  measure() {
    this.width = this.element.clientWidth;
  }

  /* A calm axis: it moves only where the curve leaves it or fills less than .45 of it. */
  fit(series, extra) {
    let low = this.zero ? 0 : Infinity, high = this.zero ? 0 : -Infinity;
    for (const { y } of series) {
      for (let i = 0; i < y.length; ++i) {
        if (y[i] < low) low = y[i];
        if (y[i] > high) high = y[i];
      }
    }
    for (const y of extra) {
      low = Math.min(low, y);
      high = Math.max(high, y);
    }
    if (!(high > low)) {
      const room = Math.max(1e-9, Math.abs(high) * 0.02) || 1;
      low = (Number.isFinite(low) ? low : 0) - (this.zero ? 0 : room);
      high = (Number.isFinite(high) ? high : 0) + room;
    }
    if (this.symmetric) {
      high = Math.max(high, -low);
      low = -high;
    }
    const r = this.range, wide = high - low;
    if (!r || low < r[0] || high > r[1] || wide < 0.45 * (r[1] - r[0])) {
      const room = 0.08 * wide;
      this.range = [this.zero ? 0 : low - room, high + room];
    }
  }

  /* series: {y, colour, width, dash, step}; limits, hatches ([from, to]), marks (times), h, stop. */
  draw({ series, limits = [], hatches = [], marks = [], fit = [], h, stop, axis }) {
    const { width, height } = this, ratio = window.devicePixelRatio || 1;
    if (!width) return;
    const tall = height + (axis ? 22 : 0);
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(tall * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(tall * ratio);
      this.canvas.style.height = tall + 'px';
    }
    this.fit(series, fit);
    const [low, high] = this.range, c = opaque(this.canvas, width, tall, ratio);
    const X = (t) => LEFT + (width - LEFT - RIGHT) * t / stop;
    const Y = (y) => height - 6 - (height - 12) * (y - low) / (high - low);
    this.X = X;
    this.Y = Y;
    c.lineWidth = 1;
    const step = niceStep(high - low, Math.max(3, Math.min(5, height / 24)));
    c.textAlign = 'right';
    c.textBaseline = 'middle';
    for (let y = Math.ceil(low / step) * step; y <= high + 1e-12; y += step) {
      c.strokeStyle = colour('hairline');
      c.beginPath();
      c.moveTo(LEFT, Math.round(Y(y)) + 0.5);
      c.lineTo(width - RIGHT, Math.round(Y(y)) + 0.5);
      c.stroke();
      c.fillStyle = colour('muted');
      c.fillText(tickText(y, step), LEFT - 8, Y(y));
    }
    for (const [from, to] of hatches) this.hatch(c, X(from), X(Math.min(to, stop)), height);
    c.setLineDash([2, 3]);
    c.strokeStyle = colour('lost');
    for (const y of limits) {
      if (y < low || y > high) continue;
      c.beginPath();
      c.moveTo(LEFT, Y(y));
      c.lineTo(width - RIGHT, Y(y));
      c.stroke();
    }
    c.setLineDash([]);
    c.save();
    c.beginPath();
    c.rect(LEFT, 0, width - LEFT - RIGHT + 2, height);
    c.clip();
    for (const s of series) this.curve(c, s, X, Y, h);
    c.restore();
    c.strokeStyle = colour('lost');
    c.beginPath();
    for (const t of marks) {
      c.moveTo(X(t), height - 2);
      c.lineTo(X(t), height - 9);
    }
    c.stroke();
    if (axis) this.axis(c, X, stop, width, height);
  }

  curve(c, s, X, Y, h) {
    c.strokeStyle = colour(s.colour);
    c.lineWidth = s.width || 1.9;
    c.lineJoin = 'round';
    c.setLineDash(s.dash || []);
    c.beginPath();
    for (let i = 0; i < s.y.length; ++i) {
      const x = X(i * h), y = Y(s.y[i]);
      if (s.step && i > 0) c.lineTo(x, Y(s.y[i - 1]));
      if (i === 0) c.moveTo(x, y);
      else c.lineTo(x, y);
    }
    c.stroke();
    c.setLineDash([]);
  }

  hatch(c, from, to, height) {
    c.save();
    c.beginPath();
    c.rect(from, 4, to - from, height - 8);
    c.clip();
    c.globalAlpha = 0.45;
    c.strokeStyle = colour('lost');
    c.lineWidth = 1;
    c.beginPath();
    for (let x = from - height; x < to; x += 9) {
      c.moveTo(x, height);
      c.lineTo(x + height, 0);
    }
    c.stroke();
    c.restore();
  }

  axis(c, X, stop, width, height) {
    const step = niceStep(stop, width < 500 ? 4 : 10);
    c.fillStyle = colour('muted');
    c.textAlign = 'center';
    c.textBaseline = 'alphabetic';
    for (let t = 0; t <= stop + 1e-9; t += step) {
      const last = t + step > stop + 1e-9;
      c.fillText(tickText(t, step) + (last ? ' s' : ''), Math.min(X(t), width - 14), height + 16);
    }
  }

  say(text) {
    this.canvas.setAttribute('aria-label', text);
  }
}

/* The complex plane: roots, their tracks, the open loop, the damping sector. */
class Plane {
  constructor(host) {
    this.canvas = document.createElement('canvas');
    this.canvas.setAttribute('role', 'img');
    host.append(this.canvas);
    this.height = 190;
  }

  measure() {
    this.width = this.canvas.parentElement.clientWidth;
  }

  draw(roots, paths, chosen, sector) {
    const { width, height } = this, ratio = window.devicePixelRatio || 1;
    if (!width) return;
    if (this.canvas.width !== Math.round(width * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
      this.canvas.style.height = height + 'px';
    }
    const c = opaque(this.canvas, width, height, ratio), { box } = roots;
    const X = (re) => 6 + (width - 12) * (re - box.left) / (box.right - box.left);
    const Y = (im) => 6 + (height - 28) * (1 - im / box.high);
    this.places = roots.roots.map(({ s }) => [X(s[0]), Y(s[1])]);
    const edge = box.high * sector / Math.sqrt(1 - sector * sector);
    c.fillStyle = colour('sector');
    c.beginPath();
    c.moveTo(X(0), Y(0));
    c.lineTo(X(-edge), Y(box.high));
    c.lineTo(X(box.left), Y(box.high));
    c.lineTo(X(box.left), Y(0));
    c.fill();
    c.lineWidth = 1;
    c.textBaseline = 'alphabetic';
    for (let re = Math.ceil(box.left); re <= box.right; ++re) {
      c.strokeStyle = colour(re === 0 ? 'muted' : 'hairline');
      c.beginPath();
      c.moveTo(Math.round(X(re)) + 0.5, 6);
      c.lineTo(Math.round(X(re)) + 0.5, height - 22);
      c.stroke();
      c.fillStyle = colour('muted');
      c.textAlign = 'center';
      c.fillText(minus(re), X(re), height - 6);
    }
    c.textAlign = 'left';
    for (let f = 0.5; f * 2 * Math.PI < box.high; f += box.high > 12 ? 1 : 0.5) c.fillText(f + ' Hz', 10, Y(f * 2 * Math.PI) + 4);
    c.fillStyle = colour('stable');
    c.fillText('damping > ' + sector, 10, height - 28);
    c.fillStyle = colour('controller');
    for (const [re, im, factor] of paths) {
      c.globalAlpha = factor > 1 ? 0.28 : 0.5;
      c.beginPath();
      c.arc(X(re), Y(im), 1.6, 0, 7);
      c.fill();
    }
    c.globalAlpha = 1;
    c.strokeStyle = colour('reference');
    c.lineWidth = 1.4;
    for (const [re, im] of roots.open) {
      const x = X(re), y = Y(im);
      c.beginPath();
      c.moveTo(x - 4, y - 4);
      c.lineTo(x + 4, y + 4);
      c.moveTo(x + 4, y - 4);
      c.lineTo(x - 4, y + 4);
      c.stroke();
    }
    if (roots.exact) roots.roots.forEach(({ s }, k) => this.root(c, X(s[0]), Y(s[1]), s[0] > 0, k === chosen));
    else if (chosen >= 0 && this.places[chosen]) this.root(c, ...this.places[chosen], roots.roots[chosen].s[0] > 0, true);
  }

  root(c, x, y, unstable, chosen) {
    c.fillStyle = colour(unstable ? 'lost' : 'controller');
    c.strokeStyle = colour('card');
    c.lineWidth = 1.5;
    c.beginPath();
    if (unstable) {
      for (const [dx, dy] of [[0, -6.5], [6.5, 0], [0, 6.5], [-6.5, 0]]) c.lineTo(x + dx, y + dy);
      c.closePath();
    } else c.arc(x, y, 5, 0, 7);
    c.fill();
    c.stroke();
    if (chosen) {
      c.strokeStyle = colour('ink');
      c.beginPath();
      c.arc(x, y, 9, 0, 7);
      c.stroke();
    }
  }

  /* The root nearest to a click. */
  near(x, y) {
    let best = -1, least = 18;
    this.places.forEach(([a, b], k) => {
      if (Math.hypot(a - x, b - y) < least) {
        least = Math.hypot(a - x, b - y);
        best = k;
      }
    });
    return best;
  }
}
