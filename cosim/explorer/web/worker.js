/* The worker: runs the container and finds the eigenvalues. Messages:
 *   {start, data, wasm, parts}                     -> {ready}
 *   {run, state, every, coarse, all, base, roots, track}
 *       -> {eigenvalues: run, ...}, {result: run, ...} | {error: run, why} | {dropped: run}, {track: run, paths}
 * The newest run wins: of those that wait only the last is done, and an exact run makes way for it. A coarse one
 * is always finished: else nothing would be drawn while somebody drags faster than a run takes. */
'use strict';

/* The target of records.py's `delta`. */
function undelta(reference, changes) {
  const view = new DataView(changes.buffer, changes.byteOffset, changes.byteLength), pieces = [];
  let size = 0;
  for (let at = 0; at < changes.length;) {
    const start = view.getUint32(at, true), length = view.getUint32(at + 4, true), changed = view.getUint32(at + 8, true);
    pieces.push(reference.subarray(start, start + length), changes.subarray(at + 12, at + 12 + changed));
    size += length + changed;
    at += 12 + changed;
  }
  const out = new Uint8Array(size);
  let at = 0;
  for (const piece of pieces) {
    out.set(piece, at);
    at += piece.length;
  }
  return out;
}

/* The container's C; `open` keeps a few models open, the one used longest ago is closed first. */
class Container {
  constructor(module, data, parts) {
    this.exports = new WebAssembly.Instance(module, {}).exports;
    this.data = data;
    this.parts = parts;
    this.records = [];
    this.sessions = new Map();
    this.rooms = {};
  }

  record(k) {
    if (!this.records[k]) {
      const { reference } = this.data.models.find((m) => m.part === k);
      this.records[k] = reference < 0 ? this.parts[k] : undelta(this.record(reference), this.parts[k]);
    }
    return this.records[k];
  }

  /* A piece of the instance's memory that stays reserved, at least so large. */
  room(name, bytes) {
    const room = this.rooms[name];
    if (room && room.size >= bytes) return room.at;
    if (room) this.exports.release(room.at);
    const size = Math.ceil(bytes * 1.25) + 64;
    this.rooms[name] = { at: this.exports.allocate(size), size };
    return this.rooms[name].at;
  }

  put(name, Kind, values) {
    const at = this.room(name, values.length * Kind.BYTES_PER_ELEMENT);
    new Kind(this.exports.memory.buffer, at, values.length).set(values);
    return at;
  }

  text(at) {
    const bytes = new Uint8Array(this.exports.memory.buffer, at);
    return new TextDecoder().decode(bytes.slice(0, bytes.indexOf(0)));
  }

  open(k) {
    let session = this.sessions.get(k);
    if (session === undefined) {
      if (this.sessions.size >= 4) {
        const [oldest] = this.sessions.keys();
        this.exports.close(this.sessions.get(oldest));
        this.sessions.delete(oldest);
      }
      const record = this.record(k), guid = new TextEncoder().encode(this.data.guid + '\0');
      session = this.exports.open(this.put('record', Uint8Array, record), record.length, this.put('guid', Uint8Array, guid));
      if (!this.exports.is_open(session)) throw new Error(this.text(this.exports.message(session)));
    }
    this.sessions.delete(k);
    this.sessions.set(k, session);
    return session;
  }

  /* Starts a run, with `solver` one that is only looked at; throws the container's own sentence. Parameters that the model does not have, such as those
   * of a channel that nobody listens to, are left out. */
  start(settings, solver) {
    const of = this.data.models.filter((m) => m.controller === settings.controller);
    const model = of.find((m) => m.point === settings.point), names = of.find((m) => m.reals);
    const parameters = solver ? { ...settings.parameters, 'plant.solver.step': solver.fast } : settings.parameters;
    const split = (table) => {
      const keys = Object.keys(parameters).filter((key) => key in table);
      return [keys.map((key) => table[key]), keys.map((key) => parameters[key])];
    };
    const [realReferences, reals] = split(names.parameters), [wholeReferences, whole] = split(names.whole);
    this.session = this.open(model.part);
    const status = this.exports.start(this.session, this.put('rr', Uint32Array, realReferences),
      this.put('rv', Float64Array, reals), reals.length, this.put('ir', Uint32Array, wholeReferences),
      this.put('iv', Int32Array, whole), whole.length, this.data.stop, solver ? solver.drawn : 0);
    if (status !== 0) throw new Error(this.text(this.exports.message(this.session)));
    return names;
  }

  /* Rows first to last, `h` apart; fewer where a step failed. */
  rows(first, last, h, reals, integers) {
    const width = reals.length + integers.length, count = last - first + 1;
    const rr = this.put('or', Uint32Array, reals), ir = this.put('oi', Uint32Array, integers);
    const at = this.room('rows', 8 * width * count);
    const done = this.exports.run(this.session, first, last, h, rr, reals.length, ir, integers.length, at);
    return new Float64Array(this.exports.memory.buffer, at, done * width).slice();
  }
}

/* Columns of the rows that are asked for: every output, or those that the page draws. */
function columnsOf(data, names, all) {
  const drawn = (name) => /_(dw|delta)$|^tie_p$/.test(name) || !data.machines.some((m) => name.startsWith(m.name + '_'))
    || data.controllers.some((c) => c.outputs.includes(name));
  const pick = (table) => Object.entries(table).filter(([name]) => all || drawn(name));
  return { reals: pick(names.reals), integers: pick(names.integers) };
}

const ASTRAY = 1;   /* s that a coarse run goes on after machines have lost synchronism */

/* One run in pieces; between two of them `goOn` says whether anybody still wants it. A coarse run ends a while after
 * machines have lost synchronism: where they slip, hundreds of limiters switch a second and nothing more is decided. */
async function simulate(container, request, goOn) {
  const { data } = container, began = performance.now();
  const names = container.start(request.settings, request.solver);
  const { reals, integers } = columnsOf(data, names, request.all);
  const h = data.step * request.every, count = Math.floor(data.stop / h + 1e-9);
  const width = reals.length + integers.length, piece = Math.max(1, Math.round(2 / h));
  const rows = new Float64Array((count + 1) * width), columns = [...reals, ...integers].map((p) => p[0]);
  let done = 0, why = '', lost = NaN;
  while (done <= count && !(done * h > lost + ASTRAY)) {
    const number = Math.min(piece, count + 1 - done);
    const part = container.rows(done, done + number - 1, h, reals.map((p) => p[1]), integers.map((p) => p[1]));
    rows.set(part, done * width);
    done += part.length / width;
    if (part.length < number * width) {
      why = container.text(container.exports.message(container.session));
      break;
    }
    if (request.coarse && !Number.isFinite(lost)) lost = (done - number) * h + outOfStep(request.islands, { columns, rows: part, h });
    else if (!request.coarse && performance.now() - began > 60 && !(await goOn())) return null;
  }
  return { columns, rows: rows.subarray(0, done * width).slice(), h, why, ms: performance.now() - began };
}

/* Gives the worker a turn to receive what has come meanwhile. */
function turn() {
  return new Promise((resolve) => {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = () => {
      port1.close();
      resolve();
    };
    port2.postMessage(0);
  });
}

function serve(scope) {
  let container = null, waiting = null, busy = false, eigenvalues = null, begun = false;

  const answer = async (request) => {
    const { data } = container;
    const goOn = async () => {
      await turn();
      return waiting === null || request.coarse || request.keep;
    };
    const first = !begun, roots = () => {
      if (!request.roots) return;
      const modes = eigenvalues.of(request.state);
      scope.postMessage({ eigenvalues: request.run, ...modes, least: leastDamped(modes.roots) });
    };
    begun = true;
    try {
      if (!first) roots();   /* at once; the first ones are looked for from afar: curves before them */
      const exact = { settings: settingsOf(data, request.state), islands: islandsOf(data, request.state), every: request.every, all: request.all, coarse: request.coarse,
        solver: request.coarse ? data.solver : null };
      const result = await simulate(container, exact, goOn);
      if (!result) return scope.postMessage({ dropped: request.run });
      const sent = { result: request.run, ...result, exact: !request.coarse, judged: judge(data, request.state, result) };
      const transfer = [result.rows.buffer];
      if (request.base) {
        const alone = { ...request.state, k: 'none' };
        const base = await simulate(container, { ...exact, settings: settingsOf(data, alone), all: false }, goOn);
        if (base) {
          sent.base = { ...base, judged: judge(data, alone, base) };
          transfer.push(base.rows.buffer);
        }
      }
      scope.postMessage(sent, transfer);
      if (first) roots();
      if (request.track) {
        const track = await eigenvalues.track(request.state, goOn);
        if (track) scope.postMessage({ track: request.run, ...track });
      }
    } catch (error) {
      scope.postMessage({ error: request.run, why: error.message });
    }
    return undefined;
  };

  scope.onmessage = async ({ data: message }) => {
    if (message.start) {
      const module = await WebAssembly.compile(message.wasm);
      container = new Container(module, message.data, message.parts);
      eigenvalues = new Eigenvalues(message.data);
      return scope.postMessage({ ready: true });
    }
    if (waiting && waiting.run !== undefined) scope.postMessage({ dropped: waiting.run });
    waiting = message;
    if (busy) return undefined;
    busy = true;
    while (waiting) {
      const next = waiting;
      waiting = null;
      await answer(next);
    }
    busy = false;
    return undefined;
  };
}
