/* The address keeps what differs from the start, in the units of the labels: #v=1&k=ftc&remote.latency=450. */
'use strict';

function toLink(data, state, keys) {
  const pairs = [];
  for (const key of keys) {
    const now = value(data, state, key);
    if (now !== value(data, {}, key)) pairs.push([key, now]);
  }
  return pairs.length ? '#' + new URLSearchParams([['v', data.version], ...pairs]) : '';
}

/* {state, why}: nonsense gives the start and one sentence. */
function fromLink(data, hash, keys) {
  if (hash.length < 2) return { state: {}, why: '' };
  const refuse = (why) => ({ state: {}, why: `This link ${why}: the page shows its start.` });
  const state = {}, pairs = [...new URLSearchParams(hash.slice(1))];
  const version = pairs.find(([key]) => key === 'v');
  if (!version || version[1] !== String(data.version)) return refuse(`is not one of version ${data.version}`);
  for (const [key, text] of pairs) {
    if (key === 'v') continue;
    if (!keys.includes(key)) return refuse(`has a setting ${JSON.stringify(key)} that this page lacks`);
    const allowed = allowedOf(data, key);
    if (allowed.list) {
      const match = allowed.list.find((x) => String(x) === text);
      if (match === undefined) return refuse(`has ${key} = ${JSON.stringify(text)}, allowed: ${allowed.list.slice(0, 12).join(', ')}`);
      state[key] = match;
    } else {
      const x = text.trim() === '' ? NaN : Number(text);
      if (!(x >= allowed.range[0] && x <= allowed.range[1]) || (allowed.whole && !Number.isInteger(x)))
        return refuse(`has ${key} = ${JSON.stringify(text)}, allowed: ${allowed.range.join(' to ')}`);
      state[key] = x;
    }
  }
  return { state, why: '' };
}

/* What a key may be: a list of values, or the range of its slider and what the start has. */
function allowedOf(data, key) {
  const part = key.includes('.') ? key.split('.').pop() : key;
  const names = (kind) => data.events[kind].map((p) => p.name);
  switch (part) {
    case 'k': return { list: ['none', ...data.controllers.map((c) => c.key)] };
    case 'ev': return { list: [...['nudge', 'power', 'fault', 'load', 'trip'].filter((kind) => data.events[kind].length), data.start.ev === 'given' ? 'given' : 'nothing'] };
    case 'nudge': case 'power': case 'fault': case 'load': case 'trip': return { list: names(part) };
    case 'br': return { list: ['', ...names('trip')] };
    case 'op': return { list: data.points.map((_, k) => k) };
    case 'on_loss': return { list: Object.keys(ON_LOSS) };
    case 'cl': return { range: [0, data.ceilings ? data.ceilings.least + 12 : 0] };
    case 'wrong': return { list: kindsOf(data, key) };
    case 'seed': return { range: [0, 2147483647], whole: true };
    default: {
      const range = data.ranges[part];
      const start = value(data, {}, key);
      return { range: [Math.min(range[0], start), Math.max(range[1], start)] };
    }
  }
}

const CHANNEL_KEYS = ['latency', 'loss', 'burst', 'lost', 'wrong', 'since', 'back', 'jitter', 'interval', 'seed', 'on_loss', 'hold'];

/* Every key that this page has. */
function keysOf(data) {
  const kinds = ['nudge', 'power', 'fault', 'load', 'trip'].filter((kind) => data.events[kind].length);
  return ['k', 'g', 'l', ...data.channels.flatMap((c) => CHANNEL_KEYS.map((part) => `${c.name}.${part}`)), 'ev', ...kinds,
    'sz', 'tc', 'br', ...(data.ceilings ? ['cl'] : []), 'op'];
}
