/* From the state of the page to what the container is given, and to the scenario that says the same.
 * A state maps short keys to numbers in the units of the labels; `value` fills in what it lacks. */
'use strict';

const NEVER = 1e30;
const ON_LOSS = { zero: 0, hold: 1, hold_then_zero: 2 };
const CHANNEL_START = {
  latency: 0, loss: 0, burst: 1, jitter: 0, interval: 0, seed: 0, on_loss: 'hold_then_zero', hold: 500, since: 1.5,
};

/* The value of a key: of the state, else of the start, else the default of its kind. */
function value(data, state, key) {
  if (key in state) return state[key];
  if (key in data.start) return data.start[key];
  const part = key.split('.')[1];
  if (part === 'lost' || part === 'back') return data.stop;
  if (part === 'wrong') return kindsOf(data, key)[0];
  if (part !== undefined) return CHANNEL_START[part];
  if (key === 'l') {
    const controller = controllerOf(data, state);
    return controller ? controller.limit : 0;
  }
  if (key === 'at') return 1;
  if (key === 'end') return value(data, state, 'at') + 0.2;
  const first = (kind) => (data.events[kind].length ? data.events[kind][0].name : '');
  return {
    k: 'none', g: 1, op: 0, ev: 'nothing', sz: 10, tc: 100, br: '', cl: 0,
    nudge: first('nudge'), power: first('power'), fault: first('fault'), trip: first('trip'),
    load: first('load'),
  }[key];
}

/* What can be wrong with the signal of a channel; the first is the start. */
const kindsOf = (data, key) => data.channels.find((c) => key === c.name + '.wrong').kinds;

function controllerOf(data, state) {
  const key = value(data, state, 'k');
  return data.controllers.find((c) => c.key === key) || null;
}

/* Channels that the chosen controller listens to. */
function channelsOf(data, state) {
  const controller = controllerOf(data, state);
  return controller ? data.channels.filter((c) => controller.inputs.includes(c.signal)) : [];
}

/* The table of one channel, as a scenario has it. */
function channelTable(data, state, channel) {
  const get = (part) => value(data, state, channel.name + '.' + part);
  const start = (part) => value(data, {}, channel.name + '.' + part);
  const table = { ...channel.table, signal: channel.signal };
  const set = (key, setting, none) => {
    if (setting === none) delete table[key];
    else table[key] = setting;
  };
  const loss = get('loss'), burst = get('burst'), jitter = get('jitter');
  set('latency_s', get('latency') / 1000, 0);
  set('jitter_s', jitter / 1000, 0);
  table.on_loss = get('on_loss');
  table.hold_s = get('hold') / 1000;
  if (loss !== start('loss') || burst !== start('burst')) {
    const rate = loss / 100;
    if (rate === 0) delete table.loss;
    else if (burst <= 1) table.loss = { kind: 'bernoulli', rate };
    else {
      table.loss = { kind: 'gilbert_elliott', good_to_bad: rate / (1 - rate) / burst, bad_to_good: 1 / burst,
        loss_good: 0, loss_bad: 1 };
    }
  }
  const wrong = data.wrong[get('wrong')];
  if (wrong) table.signal_faults = [{ ...wrong.table, start_s: get('since') }];
  else if (get('wrong') === 'none') delete table.signal_faults;
  const packets = table.loss || table.jitter_s || table.latency || table.pdc_wait_s || (wrong && wrong.packets);
  if (table.loss || table.jitter_s || table.latency || table.signal_faults) table.seed = get('seed');
  else delete table.seed;
  set('reporting_interval_s', (get('interval') || (packets ? 20 : 0)) / 1000, 0);
  const later = (channel.table.outages_s || []).slice(1);
  const lost = get('lost'), back = Math.min(get('back'), data.stop);
  const windows = lost < data.stop && back > lost ? [[lost, back]] : [];
  for (const w of later) if (!windows.length || w[0] >= windows[windows.length - 1][1]) windows.push(w);
  if (windows.length) table.outages_s = windows;
  else delete table.outages_s;
  return table;
}

/* The parameters of that channel, as `ChannelLine.parameters` has them. */
function channelParameters(name, table, out) {
  const put = (key, x) => { out[name + '.' + key] = x; };
  const loss = table.loss || {};
  put('latency', table.latency_s || 0);
  put('on_loss', ON_LOSS[table.on_loss]);
  put('hold_time', table.hold_s);
  put('reporting_interval', table.reporting_interval_s || 0);
  put('jitter', table.jitter_s || 0);
  put('seed', table.seed || 0);
  put('loss_good', loss.kind === 'bernoulli' ? loss.rate : loss.loss_good || 0);
  put('loss_bad', loss.kind === 'gilbert_elliott' ? loss.loss_bad : 0);
  put('good_to_bad', loss.good_to_bad || 0);
  put('bad_to_good', loss.bad_to_good || 0);
  for (let k = 0; k < 8; ++k) {
    const [start, end] = (table.outages_s || [])[k] || [NEVER, NEVER];
    put('outage[' + (k + 1) + '].start', start);
    put('outage[' + (k + 1) + '].end', end);
  }
}

/* Those of the fault that the page sets. */
function faultParameters(data, state, name, out) {
  const which = value(data, state, name + '.wrong'), wrong = data.wrong[which];
  if (which === 'given') return;
  const [size, detail] = wrong ? Object.values(wrong.table).slice(1) : [];
  const fault = { kind: wrong ? wrong.code : 0, size: size || 0, detail: detail || 0, start: wrong ? value(data, state, name + '.since') : NEVER, end: NEVER };
  for (const key in fault) out[`${name}.fault[1].${key}`] = fault[key];
}

/* What happens, as the tables of a scenario. */
function eventTables(data, state) {
  const get = (key) => value(data, state, key);
  const kind = get('ev'), at = get('at'), size = get('sz') / 100;
  switch (kind) {
    case 'given': return data.events.given.tables;
    case 'nudge': return [{ kind: 'vref_pulse', machine: get('nudge'), size_pu: size, start_s: at, end_s: get('end') }];
    case 'power': return [{ kind: 'pm_pulse', machine: get('power'), size_pu: size, start_s: at, end_s: get('end') }];
    case 'load': return [{ kind: 'load_step', load: get('load'), size_pu: size, start_s: at }];
    case 'trip': return [{ kind: 'branch_trip', branch: get('trip'), start_s: at }];
    case 'fault': {
      const end = at + get('tc') / 1000, opened = get('br');
      const fault = { kind: 'bus_fault', bus: Number(get('fault')), start_s: at, end_s: end, x_pu: 1e-4 };
      return opened ? [fault, { kind: 'branch_trip', branch: opened, start_s: end }] : [fault];
    }
    default: return [];
  }
}

function eventParameters(data, state, out) {
  if (value(data, state, 'ev') === 'given') return Object.assign(out, data.events.given.parameters);
  const place = { vref_pulse: 'nudge', pm_pulse: 'power', load_step: 'load', branch_trip: 'trip', bus_fault: 'fault' };
  const loads = data.points[value(data, state, 'op')].loads;
  eventTables(data, state).forEach((e, k) => {
    const name = e.machine || e.load || e.branch || e.bus;
    const entry = data.events[place[e.kind]].find((p) => p.name === name);
    const size = e.kind === 'load_step' ? [e.size_pu * loads[e.load][0], e.size_pu * loads[e.load][1]]
      : [e.size_pu || 0, 0];
    const put = (key, x) => { out['plant.event[' + (k + 1) + '].' + key] = x; };
    put('kind', data.events.codes[e.kind]);
    put('target', entry.target);
    put('start', e.start_s);
    put('end', e.end_s === undefined ? NEVER : e.end_s);
    put('size', size[0]);
    put('size_q', size[1]);
    put('r', 0);
    put('x', e.x_pu || 0);
  });
  return out;
}

/* Which model, and the start values of its parameters: name -> number. */
function settingsOf(data, state) {
  const controller = controllerOf(data, state), gain = value(data, state, 'g'), ceiling = value(data, state, 'cl');
  const parameters = eventParameters(data, state, {});
  for (const channel of channelsOf(data, state)) {
    channelParameters(channel.name, channelTable(data, state, channel), parameters);
    faultParameters(data, state, channel.name, parameters);
  }
  if (controller) {
    parameters['controller.limit'] = value(data, state, 'l');
    if (gain !== 1 && controller.C) {
      controller.C.forEach((row, i) => row.forEach((x, j) => {
        parameters['controller.C[' + (i + 1) + ',' + (j + 1) + ']'] = gain * x;
      }));
      controller.D.forEach((row, i) => row.forEach((x, j) => {
        if (x !== 0) parameters['controller.D[' + (i + 1) + ',' + (j + 1) + ']'] = gain * x * controller.scale[j];
      }));
    }
  }
  if (ceiling && data.ceilings) {
    for (const machine of data.ceilings.machines) {
      parameters['plant.' + machine + '.exciter.Efd_max'] = ceiling;
      parameters['plant.' + machine + '.exciter.Efd_min'] = -ceiling;
    }
  }
  return { controller: controller ? controller.key : 'none', point: value(data, state, 'op'), parameters };
}

const WHOLE = new Set(['bus', 'seed']);

function tomlValue(key, x) {
  if (typeof x === 'string') return JSON.stringify(x);
  if (typeof x === 'boolean') return String(x);
  if (Array.isArray(x)) return '[' + x.map((y) => tomlValue(key, y)).join(', ') + ']';
  if (typeof x === 'object')
    return '{ ' + Object.entries(x).map(([k, y]) => k + ' = ' + tomlValue(k, y)).join(', ') + ' }';
  const text = String(x);
  return WHOLE.has(key) || /[.e]/.test(text) ? text : text + '.0';
}

function tomlTable(table) {
  return Object.entries(table).map(([k, x]) => (/^[\w-]+$/.test(k) ? k : JSON.stringify(k)) + ' = ' + tomlValue(k, x) + '\n')
    .join('');
}

/* The scenario that `interarea run` repeats: everything that the page sets. */
function tomlOf(data, state, title) {
  const controller = controllerOf(data, state), gain = value(data, state, 'g'), ceiling = value(data, state, 'cl');
  const head = { title, case: data.case.reference, controller: controller ? controller.key : 'none' };
  if (controller && gain !== 1) head.controller_gain = gain;
  if (controller && value(data, state, 'l') !== controller.limit) head.controller_limit_pu = value(data, state, 'l');
  head.stop_s = data.stop;
  head.step_s = data.step;
  let text = tomlTable(head);
  const changes = data.points[value(data, state, 'op')].changes;
  if (Object.keys(changes).length) text += '\n[operating_point]\n' + tomlTable(changes);
  const plant = { ...data.plant };
  if (ceiling && data.ceilings) {
    for (const machine of data.ceilings.machines) {
      plant[machine + '.exciter.Efd_max'] = ceiling;
      plant[machine + '.exciter.Efd_min'] = -ceiling;
    }
  }
  if (Object.keys(plant).length) text += '\n[plant]\n' + tomlTable(plant);
  for (const channel of channelsOf(data, state))
    text += '\n[channels.' + channel.name + ']\n' + tomlTable(channelTable(data, state, channel));
  for (const event of eventTables(data, state)) text += '\n[[event]]\n' + tomlTable(event);
  return text + '\n[master]\njoint = true\n';
}
