/* Sliders, radio groups and lists from what the grid offers; each changes one key of the state. */
'use strict';

/* A slider: {key, label, min, max, step, text(value)}; `scale` bends it where small values matter more. */
class Slider {
  constructor(host, spec, change) {
    Object.assign(this, spec);
    this.element = document.createElement('div');
    this.element.className = 'slider';
    const id = 'c-' + this.key.replace(/\W/g, '-');
    this.element.innerHTML = `<label for="${id}"></label><output for="${id}"></output><input type="range" id="${id}" min="0" max="1000" step="1">`;
    this.element.querySelector('label').textContent = this.label;
    this.input = this.element.querySelector('input');
    this.output = this.element.querySelector('output');
    this.input.addEventListener('input', () => change(this.key, this.fromPlace(Number(this.input.value))));
    const restore = () => change(this.key, undefined);
    this.input.addEventListener('dblclick', restore);
    this.input.addEventListener('keydown', (e) => {
      const forward = { ArrowRight: 1, ArrowUp: 1, PageUp: 10, ArrowLeft: -1, ArrowDown: -1, PageDown: -10 }[e.key];
      if (e.key === 'Delete') restore();
      else if (forward) {
        e.preventDefault();
        change(this.key, this.clip(Math.round((this.now + forward * this.step) / this.step) * this.step));
      }
    });
    host.append(this.element);
  }

  clip(x) {
    return Number(Math.min(this.max, Math.max(this.min, x)).toPrecision(12));
  }

  fromPlace(place) {
    const share = (place / 1000) ** (this.bend || 1);
    return this.clip(Math.round((this.min + share * (this.max - this.min)) / this.step) * this.step);
  }

  set(x) {
    if (x === this.now) return;
    this.now = x;
    const share = ((Math.min(this.max, Math.max(this.min, x)) - this.min) / (this.max - this.min)) ** (1 / (this.bend || 1));
    this.input.value = Math.round(1000 * share);
    const text = this.text(x);
    this.output.textContent = text;
    this.input.setAttribute('aria-valuetext', text);
    this.input.style.setProperty('--share', (100 * share).toFixed(1) + '%');
  }
}

class Choice {
  constructor(host, { key, label, options }, change) {
    this.key = key;
    this.element = document.createElement('div');
    this.element.className = 'choice';
    this.element.setAttribute('role', 'radiogroup');
    this.element.setAttribute('aria-label', label);
    this.inputs = options.map(([name, text]) => {
      const wrap = document.createElement('label'), input = document.createElement('input');
      input.type = 'radio';
      input.name = 'r-' + key;
      input.value = name;
      input.addEventListener('change', () => change(key, name));
      wrap.append(input, Object.assign(document.createElement('span'), { textContent: text }));
      this.element.append(wrap);
      return input;
    });
    host.append(this.element);
  }

  set(x) {
    if (x === this.now) return;
    this.now = x;
    for (const input of this.inputs) input.checked = input.value === String(x);
  }
}

class List {
  constructor(host, { key, label, options, number }, change) {
    this.key = key;
    this.element = document.createElement('div');
    this.element.className = 'list';
    const id = 'c-' + key.replace(/\W/g, '-');
    this.element.innerHTML = `<label for="${id}"></label><select id="${id}"></select>`;
    this.element.querySelector('label').textContent = label;
    this.select = this.element.querySelector('select');
    for (const [name, text] of options) this.select.append(new Option(text, name));
    this.select.addEventListener('change', () => change(key, number ? Number(this.select.value) : this.select.value));
    host.append(this.element);
  }

  set(x) {
    if (x === this.now) return;
    this.now = x;
    this.select.value = String(x);
  }
}

const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);

function signalWords(signal) {
  const words = { dw: 'speed', delta: 'angle', pe: 'power', vt: 'voltage' };
  const [machine, what] = [signal.slice(0, signal.lastIndexOf('_')), signal.slice(signal.lastIndexOf('_') + 1)];
  return words[what] ? `${words[what]} of ${machine}` : signal === 'tie_p' ? 'tie power' : signal;
}

function controllerWords(controller) {
  const name = controller.key.replace(/^.*\//, '').replace(/\.json$/, '').replace(/_/g, ' ');
  return name.length < 5 ? name.toUpperCase() : capital(name);
}

const EVENT_WORDS = { nudge: 'Nudge', power: 'Power', fault: 'Fault', load: 'Load', trip: 'Line', given: 'As given', nothing: 'None' };
const EVENT_TEXT = {
  nudge: 'Voltage set-point raised for a moment.', power: 'Mechanical power raised for a moment.',
  fault: 'Three-phase fault, cleared by opening a branch.', load: 'A load changes for good.',
  trip: 'A branch opens for good.', given: 'What the scenario says.', nothing: 'Nothing happens.',
};

/* Builds all controls; returns {key: control} and a function that shows and hides them for a state. */
function buildControls(host, data, change) {
  const controls = {}, groups = [];
  const ms = (x) => (x > 0 ? minus(Number(x.toFixed(1))) + ' ms' : 'none');
  const group = (title, role, shown) => {
    const section = document.createElement('section');
    section.innerHTML = '<h2><i class="dot"></i><span></span></h2><p class="note"></p>';
    section.querySelector('i').classList.add(role);
    section.classList.add('as-' + role);
    section.querySelector('span').textContent = title;
    section.note = section.querySelector('.note');
    host.append(section);
    groups.push({ section, shown });
    return section;
  };
  const add = (kind, where, spec, shown) => {
    const control = new kind(where, spec, change);
    control.shown = shown || (() => true);
    controls[spec.key] = control;
    return control;
  };
  const is = (key, ...values) => (state) => values.includes(value(data, state, key));

  const own = group('Controller', 'controller');
  const controllers = data.controllers;
  const options = [['none', 'None'], ...controllers.map((c) => [c.key, controllerWords(c)])];
  add(options.length > 9 ? List : Choice, own, { key: 'k', label: 'Controller', options });
  const driven = (state) => controllerOf(data, state) !== null;
  add(Slider, own, { key: 'g', label: 'Gain', min: 0, max: 3, step: 0.01, text: (x) => '× ' + x.toFixed(2) },
    (state) => driven(state) && Boolean(controllerOf(data, state).C));
  add(Slider, own, { key: 'l', label: 'Limit of its output', min: 0.01, max: 0.3, step: 0.005, text: (x) => '± ' + Number(x.toFixed(4)) + ' pu' }, driven);

  data.channels.forEach((channel, k) => {
    const { name } = channel, listened = (state) => channelsOf(data, state).includes(channel);
    const section = group(`${capital(name.replace(/_/g, ' '))} signal, ${signalWords(channel.signal)}`.replace(/ channel signal,.*/, ' signal'), 'area' + (k % 2 + 1), listened);
    const key = (part) => `${name}.${part}`;
    const percent = (x) => (x > 0 ? Number(x.toFixed(1)) + ' %' : 'none');
    const time = (x) => (x >= data.stop ? 'never' : 'at ' + Number(x.toFixed(2)) + ' s');
    add(Slider, section, { key: key('latency'), label: 'Latency', min: 0, max: 1000, step: 5, bend: 1.5, text: ms });
    add(Slider, section, { key: key('loss'), label: 'Packets lost', min: 0, max: 90, step: 1, text: percent });
    add(Slider, section, { key: key('lost'), label: 'Signal lost', min: 0, max: data.stop, step: 0.1, text: time });
    add(List, section, { key: key('wrong'), label: 'Signal wrong', options: channel.kinds.map((kind) => [kind, kind]) });
    add(Slider, section, { key: key('since'), label: 'Wrong from', min: 0, max: data.stop, step: 0.1, text: time }, (state) => value(data, state, key('wrong')) in data.wrong);
    const more = document.createElement('details');
    more.innerHTML = '<summary></summary>';
    more.querySelector('summary').textContent = 'More of ' + signalWords(channel.signal);
    section.append(more);
    add(Slider, more, { key: key('back'), label: 'Signal back', min: 0, max: data.stop, step: 0.1, text: time });
    add(Slider, more, { key: key('burst'), label: 'Packets lost in a row, mean', min: 1, max: 20, step: 0.5, text: (x) => (x <= 1 ? 'independent' : Number(x.toFixed(1))) });
    add(Slider, more, { key: key('jitter'), label: 'Jitter, uniform', min: 0, max: 200, step: 1, text: ms });
    add(Slider, more, { key: key('interval'), label: 'Time between packets', min: 0, max: 200, step: 1, text: (x) => (x > 0 ? ms(x) : 'continuous') });
    add(Slider, more, { key: key('seed'), label: 'Which random packets', min: 0, max: 99, step: 1, text: (x) => 'seed ' + x });
    add(List, more, { key: key('on_loss'), label: 'While lost', options: [['zero', 'zero'], ['hold', 'hold the last value'], ['hold_then_zero', 'hold, then zero']] });
    add(Slider, more, { key: key('hold'), label: 'Hold for', min: 0, max: 2000, step: 10, text: ms }, is(key('on_loss'), 'hold_then_zero'));
  });

  const { events } = data, section = group(`Event at ${Number(value(data, {}, 'at').toFixed(3))} s`, 'ink');
  const kinds = ['nudge', 'power', 'fault', 'load', 'trip'].filter((kind) => events[kind].length && (kind !== 'power' || !events.nudge.length || data.start.ev === 'power'));
  if (data.start.ev === 'given') kinds.unshift('given');
  if (data.start.ev === 'nothing') kinds.push('nothing');
  add(Choice, section, { key: 'ev', label: 'Event', options: kinds.map((kind) => [kind, EVENT_WORDS[kind]]) });
  const places = (kind) => events[kind].map((p) => [p.name, String(p.name)]);
  for (const [kind, label] of [['nudge', 'At machine'], ['power', 'At machine'], ['fault', 'At bus'], ['load', 'Load'], ['trip', 'Branch']])
    if (events[kind].length) add(List, section, { key: kind, label, options: places(kind), number: kind === 'fault' }, is('ev', kind));
  add(Slider, section, { key: 'sz', label: 'Size', min: -30, max: 30, step: 1, text: (x) => (x > 0 ? '+' : '') + minus(Number(x.toFixed(2))) + ' %' }, is('ev', 'nudge', 'power', 'load'));
  add(Slider, section, { key: 'tc', label: 'Cleared after', min: 10, max: 600, step: 5, text: ms }, is('ev', 'fault'));
  add(List, section, { key: 'br', label: 'By opening', options: [['', 'nothing'], ...places('trip')] }, is('ev', 'fault'));
  if (data.ceilings) {
    const most = data.ceilings.least + 12;
    add(Slider, section, { key: 'cl', label: 'Field ceilings', min: data.ceilings.least - 1, max: most, step: 0.25, text: (x) => (x > 0 && x < most ? '± ' + Number(x.toFixed(2)) + ' pu' : 'none') });
    const slider = controls.cl, { set } = slider;
    slider.set = (x) => set.call(slider, x > 0 ? x : most);
    slider.clip = (x) => (x >= most ? 0 : Number(Math.max(data.ceilings.least - 1, x).toPrecision(12)));
  }
  if (data.points.length > 1)
    add(List, section, { key: 'op', label: 'Operating point', options: data.points.map((p, k) => [k, p.label]), number: true });

  const show = (state) => {
    for (const { section: part, shown } of groups) {
      const hidden = Boolean(shown) && !shown(state);
      if (part.hidden !== hidden) part.hidden = hidden;
    }
    for (const [key, control] of Object.entries(controls)) {
      const hidden = !control.shown(state);
      if (control.element.hidden !== hidden) control.element.hidden = hidden;
      control.set(value(data, state, key));
    }
    const chosen = controllerOf(data, state);
    own.note.textContent = !chosen ? 'No signal, no control: the grid as it is.'
      : chosen.bank ? `A bank of ${chosen.bank.length} controllers, output at ${chosen.outputs.join(', ')}.`
        : `Order ${chosen.order}, from ${chosen.inputs.join(', ')} to ${chosen.outputs.join(', ')}.`;
    section.note.textContent = EVENT_TEXT[value(data, state, 'ev')];
  };
  return { controls, show };
}
