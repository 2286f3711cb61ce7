/* The one-line diagram: buses where the layout puts them, machines whose hands turn with the record, the way
 * of every signal to the controller and of its output to the actuators. */
'use strict';

const SVG = 'http://www.w3.org/2000/svg';

function draw(parent, kind, attributes, text) {
  const element = document.createElementNS(SVG, kind);
  for (const [key, x] of Object.entries(attributes)) element.setAttribute(key, x);
  if (text !== undefined) element.textContent = text;
  parent.append(element);
  return element;
}

const areaName = (data, area) => 'area' + ((data.areas.indexOf(area) % 5) + 1);

class Diagram {
  constructor(host, data) {
    this.data = data;
    const many = data.buses.length > 20, most = Math.max(...data.buses.map((b) => b.y));
    this.radius = many ? 11 : 20;
    const width = 640, side = many ? 26 : 40, top = 34, inner = width - 2 * side;
    const tall = Math.min(Math.max(most * inner, many ? 150 : 60), 250);
    this.low = top + tall + this.radius + (many ? 30 : 44);
    this.place = new Map(data.buses.map((b) => [b.number, [side + inner * b.x, top + (most ? tall * b.y / most : 0)]]));
    this.svg = draw(host, 'svg', { viewBox: `0 0 ${width} ${this.low + 26}`, role: 'img' });
    this.many = many;
    this.areas();
    this.branches = data.branches.map((b, k) => this.branch(b, k));
    if (!many) for (const b of data.buses) this.bus(b);
    this.loads();
    this.ways = draw(this.svg, 'g', {});
    this.hands = data.machines.map((m) => this.machine(m));
  }

  areas() {
    if (this.data.areas.length < 2) return;
    for (const area of this.data.areas) {
      const inside = this.data.buses.filter((b) => b.area === area).map((b) => this.place.get(b.number));
      const xs = inside.map((p) => p[0]), ys = inside.map((p) => p[1]), room = this.radius + 8;
      if (this.many) {
        for (const [x, y] of inside) draw(this.svg, 'circle', { cx: x, cy: y, r: 2.4, class: 'bus ' + areaName(this.data, area) });
        continue;
      }
      const x = Math.max(2, Math.min(...xs) - room), y = Math.min(...ys) - room - 2;
      const wide = Math.min(638, Math.max(...xs) + room) - x;
      draw(this.svg, 'rect', { x, y, width: wide, height: Math.max(...ys) + room + 14 - y, rx: 12, class: 'ground ' + areaName(this.data, area) });
      draw(this.svg, 'text', { x: x + 10, y: Math.max(...ys) + room + 6, class: 'areaname ' + areaName(this.data, area) }, 'Area ' + area);
    }
  }

  branch(b) {
    const { data } = this, same = data.branches.filter((o) => String([...o.ends].sort()) === String([...b.ends].sort()));
    const [p, q] = b.ends.map((n) => this.place.get(n));
    const off = 7 * (same.indexOf(b) - (same.length - 1) / 2), long = Math.hypot(q[0] - p[0], q[1] - p[1]) || 1;
    const [nx, ny] = [-(q[1] - p[1]) / long * off, (q[0] - p[0]) / long * off];
    return draw(this.svg, 'line', { x1: p[0] + nx, y1: p[1] + ny, x2: q[0] + nx, y2: q[1] + ny, class: 'branch' + (b.closed ? '' : ' opened') });
  }

  bus(b) {
    if (this.data.machines.some((m) => m.bus === b.number)) return;
    const [x, y] = this.place.get(b.number);
    draw(this.svg, 'line', { x1: x, y1: y - 11, x2: x, y2: y + 11, class: 'bar' });
    draw(this.svg, 'text', { x, y: y - 16, class: 'number' }, b.number);
  }

  loads() {
    if (this.many) return;
    for (const b of this.data.buses.filter((o) => o.load)) {
      const [x, y] = this.place.get(b.number);
      draw(this.svg, 'path', { d: `M${x} ${y + 6}v20m-4 -6l4 6l4 -6`, class: 'branch loadmark' });
    }
  }

  machine(m) {
    const [x, y] = this.place.get(m.bus), r = this.radius, name = areaName(this.data, m.area);
    draw(this.svg, 'circle', { cx: x, cy: y, r, class: 'machine ' + name });
    const hand = draw(this.svg, 'line', { x1: x, y1: y, x2: x, y2: y - 0.72 * r, class: 'hand ' + name });
    draw(this.svg, 'circle', { cx: x, cy: y, r: this.many ? 1.5 : 3, class: 'hub ' + name });
    if (this.many) draw(this.svg, 'text', { x, y: y + r + 9, class: 'number' }, m.name);
    else draw(this.svg, 'text', { x, y: y - r - 6, class: 'number' }, m.name);
    return { hand, x, y, r };
  }

  /* Hands turned by angles, rad; lengths of a mode shape, 0..1, or full. */
  turn(angles, lengths) {
    this.hands.forEach(({ hand, x, y, r }, k) => {
      const long = 0.72 * r * (lengths ? Math.max(lengths[k], 0.04) : 1);
      hand.setAttribute('x2', (x + long * Math.sin(angles[k])).toFixed(2));
      hand.setAttribute('y2', (y - long * Math.cos(angles[k])).toFixed(2));
    });
  }

  /* Which signals come how late, what is opened: from the state. */
  show(state) {
    const { data } = this, controller = controllerOf(data, state), tables = eventTables(data, state), channels = channelsOf(data, state);
    const signals = channels.map((c) => channelTable(data, state, c)), gone = signals.map((t) => (t.outages_s || []).length > 0);
    const late = signals.map((t, k) => (gone[k] ? 'lost' : t.signal_faults ? 'wrong' : t.latency_s > 0 ? minus(Math.round(1e4 * t.latency_s) / 10) + ' ms late' : ''));
    const seen = JSON.stringify([controller && controller.key, tables, channels.map((c, k) => [c.name, gone[k]])]);
    if (seen === this.seen) {
      this.late.forEach((text, k) => { text.textContent = late[k]; });
      return;
    }
    this.seen = seen;
    this.late = [];
    this.ways.replaceChildren();
    data.branches.forEach((b, k) => {
      const opened = !b.closed || tables.some((e) => e.kind === 'branch_trip' && e.branch === b.name);
      this.branches[k].setAttribute('class', 'branch' + (opened ? ' opened' : '') + (b.kind === 'transformer' ? ' transformer' : ''));
    });
    for (const e of tables) if (e.kind === 'bus_fault') this.flash(e.bus);
    if (!controller) return;
    const at = (name) => {
      const machine = data.machines.find((m) => name.startsWith(m.name + '_'));
      return machine ? this.place.get(machine.bus) : null;
    };
    const ends = [...controller.outputs, ...controller.inputs].map(at).filter(Boolean);
    const mid = ends.reduce((sum, p) => sum + p[0], 0) / (ends.length || 1), y = this.low;
    const label = controller.key.replace(/^.*\//, '').replace(/\.json$/, '').replace(/_/g, ' ');
    const half = Math.max(26, 4 + 3.6 * label.length);
    channels.forEach((channel, k) => {
      const from = at(channel.signal);
      if (!from) return;
      const left = from[0] <= mid;
      const line = y + (k % 3 - 1) * 6, x = from[0] + (controller.outputs.some((u) => at(u) === from) ? 7 : 0);
      const role = this.role(channel);
      draw(this.ways, 'path', { d: `M${x} ${from[1] + this.radius}V${line}H${mid + (left ? -half : half)}`, class: `way ${gone[k] ? 'lostway' : role}` });
      this.late[k] = draw(this.ways, 'text', { x: (from[0] + mid + (left ? -half : half)) / 2, y: line - 5, class: `waytext ${gone[k] ? 'lostway' : role}` }, late[k]);
    });
    for (const u of controller.outputs) {
      const to = at(u);
      if (!to) continue;
      const x = to[0] - 7, turn = y - 26;
      draw(this.ways, 'path', { d: `M${mid} ${y - 11}V${turn}H${x}V${to[1] + this.radius + 5}m-4 5l4 -7l4 7`, class: 'way drive' });
    }
    draw(this.ways, 'rect', { x: mid - half, y: y - 11, width: 2 * half, height: 22, rx: 7, class: 'box' });
    draw(this.ways, 'text', { x: mid, y: y + 4, class: 'boxtext' }, label.length < 5 ? label.toUpperCase() : label);
  }

  role(channel) {
    return this.data.channels.indexOf(channel) % 2 ? 'area2' : 'area1';
  }

  flash(bus) {
    const p = this.place.get(bus);
    if (p) draw(this.ways, 'path', { d: `M${p[0] + 4} ${p[1] - 12}l-9 13h8l-5 12l13 -16h-8l6 -9z`, class: 'flash' });
  }

  say(text) {
    this.svg.setAttribute('aria-label', text);
  }
}
