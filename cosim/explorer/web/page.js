/* The page itself: state, worker, what is drawn when, presets, links, files. */
'use strict';

const $ = (id) => document.getElementById(id);
const SECTOR = 0.1;          /* the damping ratio that the plane shows */
const EXACT_AFTER = 180;     /* ms after the last input */
const JOIN_WITHIN = 60;      /* ms that what a picture goes with waits for it */

const DIGITS = '0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%.()*+-;,=>?@^_`{|}~';

/* Bytes from page.py's `as_text`: five digits of base 85 for four bytes. */
function bytesOf(text) {
  const codes = new Uint8Array(128), cut = (5 - text.length % 5) % 5, out = new DataView(new ArrayBuffer(4 * (text.length + cut) / 5));
  for (let k = 0; k < 85; ++k) codes[DIGITS.charCodeAt(k)] = k;
  for (let at = 0, to = 0; at < text.length; to += 4) {
    let word = 0;
    for (const end = at + 5; at < end; ++at) word = 85 * word + (at < text.length ? codes[text.charCodeAt(at)] : 84);
    out.setUint32(to, word);
  }
  return new Uint8Array(out.buffer, 0, out.byteLength - cut);
}

/* The gzip stream of page.py: data, the worker's source, the WebAssembly module, the records. */
async function unpack(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream('gzip'));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer()), view = new DataView(bytes.buffer);
  const pieces = [];
  let at = 4 + 4 * view.getUint32(0, true);
  for (let k = 0; k < view.getUint32(0, true); ++k) {
    const length = view.getUint32(4 + 4 * k, true);
    pieces.push(bytes.slice(at, at + length));
    at += length;
  }
  const text8 = (bytes8) => new TextDecoder().decode(bytes8);
  return [JSON.parse(text8(pieces[0])), text8(pieces[1]), pieces[2], pieces.slice(3)];
}

class Explorer {
  constructor(data, worker, wasm, parts) {
    this.data = data;
    data.areas = [...new Set(data.machines.map((m) => m.area))].sort((a, b) => a - b);
    this.keys = keysOf(data);
    this.state = {};
    this.runs = 0;
    this.flying = 0;
    this.request = null;
    this.baseKey = null;
    this.chosen = -1;
    this.paths = [];
    this.waiters = new Map();
    this.playing = false;
    this.time = 0.35;
    this.due = {};
    this.build();
    this.worker = new Worker(URL.createObjectURL(new Blob([$('shared').textContent, worker, ';serve(self);'], { type: 'text/javascript' })));
    this.worker.onmessage = ({ data: message }) => this.receive(message);
    this.worker.onerror = (event) => this.notice(event.message);
    this.worker.postMessage({ start: true, data, wasm, parts });
  }

  build() {
    const { data } = this;
    $('name').textContent = data.title || data.case.title || data.case.name;
    this.controls = buildControls($('controls'), data, (key, x) => this.change(key, x));
    this.diagram = new Diagram($('grid').querySelector('.host'), data);
    this.plane = new Plane($('plane').querySelector('.host'));
    const host = $('plots').querySelector('.host');
    this.plots = { swing: new Plot(host, { title: data.swing.label + ', mHz', height: 118 }) };
    if (data.tie) this.plots.tie = new Plot(host, { title: 'Tie power, MW', height: 92 });
    this.plots.control = new Plot(host, { title: 'Control signal, pu', height: 88, symmetric: true });
    this.plots.age = new Plot(host, { title: 'Age of the signals, ms', height: 58, zero: true });
    data.presets.forEach((preset, k) => {
      const button = document.createElement('button');
      button.type = 'button';
      button.innerHTML = '<i></i><span></span>';
      button.firstChild.textContent = k + 1;
      button.lastChild.textContent = preset.label;
      button.addEventListener('click', () => this.preset(k));
      $('presets').append(button);
    });
    $('link').addEventListener('click', () => this.copyLink());
    $('csv').addEventListener('click', () => this.saveCsv());
    $('save').addEventListener('click', () => this.download(this.fileName('toml'), tomlOf(data, this.state, this.title()), 'application/toml'));
    $('theme').addEventListener('click', () => this.theme(document.documentElement.dataset.theme !== 'dark'));
    $('play').addEventListener('click', () => this.play(!this.playing));
    $('time').addEventListener('input', () => {
      this.play(false);
      this.time = Number($('time').value) / 1000;
      this.moved();
    });
    host.addEventListener('pointermove', (e) => this.point(e, e.buttons || e.pointerType === 'mouse'));
    host.addEventListener('pointerdown', (e) => this.point(e, true));
    this.plane.canvas.addEventListener('click', (e) => this.choose(this.plane.near(e.offsetX, e.offsetY)));
    window.addEventListener('hashchange', () => this.fromAddress());
    new ResizeObserver(() => this.drawAll()).observe(document.querySelector('main'));
    new IntersectionObserver(([entry]) => {
      $('verdict').classList.toggle('away', !entry.isIntersecting && entry.boundingClientRect.top < 0);
      this.glanceWidth = $('glance').clientWidth;
      this.glance();
    }).observe(this.plots.swing.element);
    this.theme(matchMedia('(prefers-color-scheme: dark)').matches);
  }

  theme(dark) {
    document.documentElement.dataset.theme = dark ? 'dark' : 'light';
    $('theme').textContent = dark ? 'Light' : 'Dark';
    this.drawAll();
  }

  title() {
    const preset = this.data.presets.find((p, k) => this.isPreset(k));
    return preset ? `${this.data.case.name}: ${preset.label}` : `${this.data.case.name}: from the explorer`;
  }

  fileName(kind) {
    return `${this.data.name}-${this.title().split(': ')[1].toLowerCase().replace(/\W+/g, '-')}.${kind}`;
  }

  notice(text) {
    put($('notice'), text);
    if ($('notice').hidden !== !text) $('notice').hidden = !text;
  }

  /* ---- state ---- */

  change(key, x) {
    if (x === undefined) delete this.state[key];
    else this.state[key] = x;
    if (key === 'k') delete this.state.l;
    this.notice('');
    this.update();
  }

  isPreset(k) {
    const { state } = this.data.presets[k];
    const applied = (key) => key === 'k' || !key.includes('.') || channelsOf(this.data, this.state).some((c) => key.startsWith(c.name + '.'));
    return Object.entries(state).every(([key, x]) => !applied(key) || value(this.data, this.state, key) === x);
  }

  preset(k) {
    this.state = { ...this.data.presets[k].state };
    this.chosen = -1;
    this.notice('');
    this.update(true);
  }

  fromAddress() {
    const { state, why } = fromLink(this.data, location.hash, this.keys);
    this.state = state;
    this.notice(why);
    this.update(true);
  }

  /* Controls and diagram as the state has them. */
  drawState() {
    this.controls.show(this.state);
    this.diagram.show(this.state);
    const current = this.data.presets.findIndex((_, k) => this.isPreset(k));
    [...$('presets').children].forEach((button, k) => button.setAttribute('aria-pressed', k === current));
    const alone = controllerOf(this.data, this.state) === null;
    if (this.plots.control.element.hidden !== alone) {
      this.plots.control.element.hidden = this.plots.age.element.hidden = alone;
      this.measure();
    }
  }

  /* Sizes are read here and nowhere else: reading one between two changes lays the page out anew. */
  measure() {
    for (const plot of Object.values(this.plots)) plot.measure();
    this.plane.measure();
    this.glanceWidth = $('glance').clientWidth;   /* 0: not shown */
    const host = $('plots').querySelector('.host');
    this.cursor = [host.offsetLeft, host.offsetHeight - 24];
    $('cursor').style.height = this.cursor[1] + 'px';
  }

  update(settled) {
    this.later('state', !settled);
    if (!settled) $('words').setAttribute('aria-live', 'off');
    this.ask({ coarse: true, alone: settled });   /* a first picture at once, and what it is compared with later */
    if (settled) this.ask({ coarse: false });
    clearTimeout(this.timer);
    if (!settled) this.timer = setTimeout(() => this.ask({ coarse: false }), EXACT_AFTER);
    clearTimeout(this.addressTimer);
    this.addressTimer = setTimeout(() => {
      const hash = toLink(this.data, this.state, this.keys);
      if (hash !== location.hash) history.replaceState(null, '', hash || location.pathname + location.search);
    }, 260);
  }

  /* ---- worker ---- */

  ask(wish) {
    this.request = wish;
    this.send();
  }

  /* Two runs in flight: one waits in the worker, so that it never waits for drawing. */
  send() {
    if (!this.request || this.flying >= 2) return;
    const { coarse, alone } = this.request, state = { ...this.state };
    this.request = null;
    const baseKey = JSON.stringify([eventTables(this.data, state), value(this.data, state, 'cl'), value(this.data, state, 'op'), coarse]);
    const base = !alone && controllerOf(this.data, state) !== null && baseKey !== this.baseKey;
    this.flying += 1;
    this.waiters.set(++this.runs, { state, baseKey, coarse });
    this.worker.postMessage({ run: this.runs, state, coarse, every: coarse ? 4 : 1, base, roots: true, track: !coarse });
  }

  receive(message) {
    if (message.ready) return this.ready();
    const id = message.result || message.error || message.dropped || message.eigenvalues || message.track;
    const waiter = this.waiters.get(id);
    if (message.eigenvalues) {
      this.roots = message;
      this.paths = [];
      this.later('plane', true);
      return undefined;
    }
    if (message.track) {
      this.paths = message.paths;
      this.later('plane');
      return undefined;
    }
    this.waiters.delete(id);
    if (waiter && waiter.resolve) {
      waiter.resolve(message);
      return undefined;
    }
    this.flying -= 1;
    if (message.result) {
      this.result = message;
      this.resultState = waiter.state;
      if (message.base) {
        this.base = message.base;
        this.baseKey = waiter.baseKey;
      }
      this.judged = message.judged;
      this.frames = (this.frames || 0) + 1;
      this.later('curves');
    } else if (message.error) {
      this.failed(message.why);
    }
    this.send();
    return undefined;
  }

  ready() {
    document.body.classList.remove('waiting');
    this.fromAddress();
    this.drawState();
    this.drawAll();
    if (!matchMedia('(prefers-reduced-motion: reduce)').matches) this.play(true);
  }

  failed(why) {
    const words = $('words');
    put(words.firstElementChild, 'Refused.');
    words.firstElementChild.className = 'bad';
    put(words.lastElementChild, why.replace(/^fmi2\w+: /, ''));
    put($('numbers'), 'The container says so; nothing was simulated.');
  }

  /* ---- drawing: at most once a frame ---- */

  /* What changes with a slider waits a moment for the picture that goes with it: one frame in place of three. */
  later(what, joins) {
    this.due[what] = true;
    if (this.frame) return;
    if (joins && !this.joining) this.joining = setTimeout(() => this.nextFrame(), JOIN_WITHIN);
    else if (!joins) this.nextFrame();
  }

  nextFrame() {
    clearTimeout(this.joining);
    this.joining = 0;
    this.frame = requestAnimationFrame(() => {
      const { due } = this;
      this.frame = 0;
      this.due = {};
      if (due.state) this.drawState();
      if (due.curves) this.drawCurves();
      if (due.plane) this.drawPlane();
      if (due.curves || due.plane) this.moved();
    });
  }

  drawAll() {
    newPalette();
    this.measure();
    if (this.result) this.later('curves');
    if (this.roots) this.later('plane');
  }

  drawCurves() {
    const { data, result, plots } = this, state = this.resultState, { h } = result, { stop } = data;
    const controller = controllerOf(data, state), base = controller && this.base && this.base.h === h ? this.base : null, shared = { h, stop };
    const withBase = (series, of) => (base ? [{ y: of(base), colour: 'reference', width: 1.1 }, ...series] : series);
    const swing = this.judged.swing;
    this.curves = { swing };
    plots.swing.draw({ ...shared, series: withBase([{ y: swing, colour: 'area1' }], () => base.judged.swing), axis: false });
    if (plots.tie) {
      const power = (r) => {
        r.power = r.power || column(r, 'tie_p').map((x) => x * data.case.base);
        return r.power;
      };
      this.curves.tie = power(result);
      plots.tie.draw({ ...shared, series: withBase([{ y: this.curves.tie, colour: 'area2' }], power), axis: controller === null });
    }
    if (controller) this.drawControl(controller, state, shared);
    this.describe();
    this.glance();
    this.drawLedger();
  }

  drawControl(controller, state, shared) {
    const { data, result, plots } = this, limit = value(data, state, 'l'), channels = channelsOf(data, state);
    const signals = controller.outputs.map((u) => column(result, u));
    let most = 0;
    for (const u of signals) for (const x of u) most = Math.max(most, Math.abs(x));
    this.curves.control = signals[0];
    plots.control.rename(`Control signal at ${controller.outputs.map((u) => u.replace(/_vs$/, '')).join(', ')}, pu`);
    put(plots.control.aside, most < 0.6 * limit ? `limit ± ${Number(limit.toFixed(4))} is far outside` : '');
    plots.control.draw({ ...shared, series: signals.map((y, k) => ({ y, colour: k ? 'ink' : 'controller', dash: k ? [5, 3] : [] })),
      limits: [limit, -limit], fit: most < 0.6 * limit ? [] : [limit, -limit] });
    const ages = channels.map((c, k) => ({ y: column(result, c.name + '_age').map((x) => 1000 * x), colour: 'area' + (data.channels.indexOf(c) % 2 + 1), step: false, dash: k % 2 ? [4, 3] : [] }));
    const entries = ledger(data, state, result), marks = [];
    for (const { name, packets, outages } of entries) {
      if (!packets) continue;
      const dropped = column(result, name + '_dropped'), away = (t) => outages.some(([from, to]) => t >= from && t < to);
      for (let i = 1; i < dropped.length; ++i) if (dropped[i] > dropped[i - 1] && !away(i * shared.h)) marks.push(i * shared.h);
    }
    const hatches = entries.flatMap((e) => e.outages);
    const cap = 3 * Math.max(60, ...entries.map((e) => e.total));
    for (const a of ages) a.y = a.y.map((x) => Math.min(x, cap));
    this.curves.age = ages.length ? ages[0].y : null;
    plots.age.rename(channels.length > 1 ? 'Age of the signals, ms' : 'Age of the signal, ms');
    put(plots.age.aside, [marks.length ? 'ticks: packets lost' : '', hatches.length ? 'hatched: no signal' : ''].filter(Boolean).join(', '));
    plots.age.draw({ ...shared, series: ages, hatches, marks, axis: true });
  }

  /* Verdict, second line, and what screen readers say of the curves. */
  describe() {
    const { data, result, judged } = this, state = this.resultState, words = $('words');
    const least = this.roots && this.roots.least;
    const [bold, rest, kind] = verdictWords(data, state, judged, least);
    words.setAttribute('aria-live', result.exact ? 'polite' : 'off');
    put(words.firstElementChild, bold, result.exact);
    words.firstElementChild.className = kind;
    put(words.lastElementChild, rest, result.exact);
    const entries = ledger(data, state, result), sent = entries.reduce((n, e) => n + e.sent, 0), lost = entries.reduce((n, e) => n + e.dropped + e.late, 0);
    put($('numbers'), [
      least ? `least damped swing: ${digits(least.hertz, 2)} Hz, damping ratio ${digits(least.zeta, 3)}` : '',
      aloneWords(data, state, judged, this.base),
      lost ? `${lost} of ${sent} packets lost or late` : '',
      judged.limited > 0.05 ? `control at its limit ${digits(judged.limited, 1)} s` : '',
      judged.kind === 'collapse' ? result.why.replace(/^fmi2\w+: /, '') : '',
    ].filter(Boolean).join(' · '));
    put($('cost'), `${result.exact ? 'exact: solver step' : 'coarse: solver step up to'} ${Number((1000 * (result.exact ? data.solver.exact : data.solver.drawn)).toFixed(2))} ms · ${Math.round((result.rows.length / result.columns.length - 1) * result.h)} s in ${Math.round(result.ms)} ms`);
    if (!result.exact) return;   /* for screen readers: what stays */
    const peak = Math.max(...judged.swing.map(Math.abs));
    this.plots.swing.say(`${data.swing.label} over ${data.stop} s: largest ${digits(peak, 1)} mHz. ${bold} ${rest}`);
    if (this.plots.tie) this.plots.tie.say(`Tie power over ${data.stop} s: ${digits(Math.min(...this.curves.tie), 0)} to ${digits(Math.max(...this.curves.tie), 0)} MW.`);
    if (this.curves.control) {
      this.plots.control.say(`Control signal: largest ${digits(Math.max(...this.curves.control.map(Math.abs)), 3)} pu, limit ${value(data, state, 'l')} pu.`);
      this.plots.age.say(`Age of the signals: ${entries.map((e) => `${e.signal} ${digits(e.total, 0)} ms mean, ${e.dropped} of ${e.sent} packets lost`).join('; ')}.`);
    }
  }

  drawLedger() {
    if (!this.result.exact) return;
    const entries = ledger(this.data, this.resultState, this.result), body = $('ledger').querySelector('tbody');
    $('ledger').hidden = entries.length === 0;
    body.replaceChildren(...entries.map((e) => {
      const row = document.createElement('tr'), ms = (x) => (x ? minus(Number(x.toFixed(2))) : '–');
      const counts = e.packets ? [e.sent, e.delivered, e.dropped, e.late] : ['continuous', '', '', ''];
      for (const text of [`${e.name}: ${signalWords(e.signal)}`, ms(e.latency), ms(e.waiting), ms(e.jitter), ms(e.total), ...counts])
        row.append(Object.assign(document.createElement('td'), { textContent: text }));
      return row;
    }));
  }

  drawPlane() {
    const { roots } = this;
    if (roots.why) {
      put($('planenote'), '· ' + roots.why);
      $('plane').querySelector('.host').hidden = true;
      $('modes').replaceChildren();
      return;
    }
    $('plane').querySelector('.host').hidden = false;
    const count = roots.roots.length;
    put($('planenote'), '· ' + [roots.exact ? roots.mean ? 'mean delay, exact' : 'exact delay' : 'no controller',
      roots.proven ? `all ${count} in sight` : 'not all found', roots.lost ? 'after the loss' : ''].filter(Boolean).join(', '));
    const swings = roots.roots.map((r, k) => [r, k]).filter(([{ s }]) => s[1] > 0.6 && -s[0] / Math.hypot(...s) < 0.6).sort(([a], [b]) => a.s[1] - b.s[1]);
    this.plane.draw(roots, this.paths, this.chosen, SECTOR);
    const text = ({ s }) => [`${digits(s[1] / (2 * Math.PI), 2)} Hz`, digits(-s[0] / Math.hypot(...s), 3)];
    this.plane.canvas.setAttribute('aria-label', `Eigenvalues in sight: ${roots.roots.map(({ s }) => `${digits(s[0], 2)} ± ${digits(s[1], 2)}j`).join(', ')}`);
    const host = $('modes');
    while (host.children.length > swings.length) host.lastChild.remove();
    while (host.children.length < swings.length) {
      const button = document.createElement('button');
      button.type = 'button';
      button.innerHTML = '<span></span> <b></b>';
      button.title = 'frequency and damping ratio; show its shape in the grid';
      button.addEventListener('click', () => this.choose(Number(button.dataset.root) === this.chosen ? -1 : Number(button.dataset.root)));
      host.append(button);
    }
    swings.forEach(([root, k], n) => {
      const button = host.children[n], [hertz, zeta] = text(root);
      button.dataset.root = k;
      put(button.firstElementChild, hertz);
      put(button.lastElementChild, zeta);
      button.className = root.s[0] > 0 ? 'bad' : '';
      button.setAttribute('aria-pressed', k === this.chosen);
    });
  }

  choose(k) {
    this.chosen = k;
    this.later('plane');
  }

  /* ---- time ---- */

  point(event, on) {
    if (!on || !this.result) return;
    const box = this.plots.swing.canvas.getBoundingClientRect();
    const share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    if (share < -0.02 || share > 1.02) return;
    this.play(false);
    this.time = Math.min(1, Math.max(0, share));
    this.moved();
  }

  play(on) {
    this.playing = on;
    $('play').textContent = on ? 'Pause' : 'Play';
    if (!on) return;
    let last = performance.now();
    const step = (now) => {
      if (!this.playing) return;
      this.time = (this.time + (now - last) / 1000 / this.data.stop) % 1;
      last = now;
      this.moved();
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  /* Everything that shows one instant: cursor, readings, hands. */
  moved() {
    const { data, result, plots } = this;
    if (!result || !plots.swing.X) return;
    const t = this.time * data.stop, rows = result.rows.length / result.columns.length, i = Math.min(rows - 1, Math.round(t / result.h));
    $('cursor').style.transform = `translateX(${plots.swing.X(t) + this.cursor[0]}px)`;
    const read = (name, n) => {
      if (plots[name] && this.curves[name]) put(plots[name].reading, i < this.curves[name].length ? digits(this.curves[name][i], n) : '');
    };
    read('swing', 0);
    read('tie', 0);
    read('control', 3);
    read('age', 0);
    put($('now'), digits(t, 1) + ' s');
    if (document.activeElement !== $('time')) $('time').value = Math.round(1000 * this.time);
    $('time').style.setProperty('--share', 100 * this.time + '%');
    $('time').setAttribute('aria-valuetext', digits(t, 1) + ' s');
    const root = this.roots && this.roots.roots && this.roots.roots[this.chosen];
    if (root) {
      this.diagram.turn(root.shape.map((z) => Math.atan2(z[1], z[0])), root.shape.map((z) => Math.hypot(...z)));
      put($('gridnote'), `· mode shape, ${digits(root.s[1] / (2 * Math.PI), 2)} Hz: length and phase of each speed`);
      this.diagram.say($('gridnote').textContent.slice(2) + ': ' + data.machines.map((m, k) => `${m.name} ${digits(Math.hypot(...root.shape[k]), 2)} at ${digits(Math.atan2(root.shape[k][1], root.shape[k][0]) * 180 / Math.PI, 0)} degrees`).join(', '));
      return;
    }
    this.turnHands(i);
  }

  turnHands(i) {
    const { data, result } = this;
    if (this.anglesOf !== result) {
      this.anglesOf = result;
      this.angles = data.machines.map((m) => column(result, m.name + '_delta'));
      let most = 0;
      for (const x of this.angles) for (const y of x) most = Math.max(most, Math.abs(y - x[0]));
      const largest = 1 / Math.max(most, 1e-6);
      this.magnified = [50, 20, 10, 5, 2, 1].find((n) => n <= largest) || 1;
      put($('gridnote'), this.magnified > 1 ? `· swing × ${this.magnified}` : '');
      this.diagram.say(`The grid: ${data.machines.length} machines, ${data.buses.length} buses; largest swing of an angle ${digits(most * 180 / Math.PI, 1)} degrees.`);
    }
    this.diagram.turn(this.angles.map((x) => this.magnified * (x[Math.min(i, x.length - 1)] - x[0])), null);
  }

  /* The small curve beside the verdict while the first plot is out of sight. */
  glance() {
    const canvas = $('glance'), width = this.glanceWidth;
    if (!this.curves || !width) return;
    const ratio = window.devicePixelRatio || 1, swing = this.curves.swing, c = canvas.getContext('2d');
    canvas.width = width * ratio;
    canvas.height = 64 * ratio;
    c.scale(ratio, ratio);
    let most = 1e-9;
    for (const x of swing) most = Math.max(most, Math.abs(x));
    c.strokeStyle = colour('area1');
    c.lineWidth = 1.6;
    c.beginPath();
    for (let i = 0; i < swing.length; ++i) c.lineTo(width * i * this.result.h / this.data.stop, 32 - 28 * swing[i] / most);
    c.stroke();
  }

  /* ---- what leaves the page ---- */

  async copyLink() {
    const link = location.href.split('#')[0] + toLink(this.data, this.state, this.keys);
    try {
      await navigator.clipboard.writeText(link);
      this.notice('The link to this setting is in the clipboard.');
    } catch (error) {
      history.replaceState(null, '', toLink(this.data, this.state, this.keys) || '#');
      this.notice('The address of this page holds the setting: copy it from there.');
    }
  }

  download(name, text, type) {
    const link = document.createElement('a');
    link.href = URL.createObjectURL(new Blob([text], { type }));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  /* The exact run with every output; resolves to {columns, rows, h, why}. */
  everything(state) {
    return new Promise((resolve) => {
      this.waiters.set(++this.runs, { state, resolve });
      this.worker.postMessage({ run: this.runs, state: { ...state }, coarse: false, every: 1, all: true, keep: true });
    });
  }

  async saveCsv() {
    const run = await this.everything(this.state);
    if (run.dropped) return this.saveCsv();
    if (run.error) return this.notice(run.why);
    const width = run.columns.length, lines = [['time_s', ...run.columns].join(',')];
    for (let i = 0; i * width < run.rows.length; ++i)
      lines.push([Number((i * run.h).toFixed(9)), ...run.rows.subarray(i * width, (i + 1) * width)].join(','));
    return this.download(this.fileName('csv'), lines.join('\n') + '\n', 'text/csv');
  }
}

(async () => {
  const able = typeof WebAssembly === 'object' && typeof DecompressionStream === 'function' && typeof Worker === 'function';
  if (!able) {
    document.body.className = 'unable';
    return;
  }
  try {
    window.explorer = new Explorer(...await unpack($('blob').textContent.trim()));
  } catch (error) {
    document.body.className = 'unable';
    $('whynot').textContent = `This picture was prepared: the page could not start (${error.message}).`;
  }
})();
