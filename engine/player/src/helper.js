// Client of the worker: numbered questions, and the last orders received.

export class Helper {
  constructor(worker) {
    this.worker = worker;
    this.asked = new Map();
    this.last = 0;
    worker.onmessage = ({ data: { ticket, error, ...answer } }) => {
      const { done, failed } = this.asked.get(ticket);
      this.asked.delete(ticket);
      if (error === undefined) done(answer);
      else failed(new Error(error));
    };
    // A worker that cannot start, or is out of memory, does not answer.
    worker.onerror = (event) => {
      const error = new Error(`worker: ${event.message || "it cannot be started"}`);
      for (const { failed } of this.asked.values()) failed(error);
      this.asked.clear();
    };
  }

  ask(question, transferred = []) {
    const ticket = ++this.last;
    return new Promise((done, failed) => {
      this.asked.set(ticket, { done, failed });
      this.worker.postMessage({ ...question, ticket }, transferred);
    });
  }

  /** Ends the worker; open questions get no answer. */
  end() {
    this.worker.terminate();
  }

  forget(interval) {
    this.worker.postMessage({ kind: "forget", interval });
  }
}

/** Returns true if two questions request the same order. */
const sameOrder = (a, b) => a.interval === b.interval && a.t === b.t && sameView(a.view, b.view);
const sameView = (a, b) => a.eye.every((x, i) => x === b.eye[i]) && a.axes.flat().every((x, i) => x === b.axes.flat()[i]) && a.pinhole === b.pinhole && (a.share ?? 1) === (b.share ?? 1);

/** Orders of records: one question is open at a time, and the last requested order is the next question. */
export class Orders {
  constructor(helper, came) {
    this.helper = helper;
    this.came = came;
    this.known = new Map();
    this.wanted = null;
    this.next = null;
    /** The open question. */
    this.asking = null;
    /** The worker's statistics: orders made, records visited, and records moved. */
    this.work = { orders: 0, records: 0, moved: 0 };
  }

  /** Returns the last order of an interval, the share of the records in it, and whether it is that of t and the view. */
  of(interval, t, view) {
    const last = this.known.get(interval);
    return last ? { order: last.order, share: last.view.share ?? 1, exact: last.t === t && sameView(last.view, view) } : null;
  }

  /** Requests the order at t, and the following interval's first one, if that has none. */
  want(interval, t, view, following) {
    const { eye, axes, units, pinhole, still, share } = view;
    const seen = { eye, axes, units, pinhole, still, share };
    const question = { interval, t, view: seen };
    const comes = this.of(interval, t, view)?.exact || (this.asking && sameOrder(this.asking, question));
    this.wanted = comes ? null : question;
    this.next = following === null || this.known.has(following) ? null : { interval: following, t: 0, view: seen };
    this.go();
  }

  async go() {
    if (this.asking) return;
    const question = this.wanted ?? this.next;
    if (!question) return;
    this.wanted === question ? (this.wanted = null) : (this.next = null);
    this.asking = question;
    const { order, work } = await this.helper.ask({ kind: "sort", ...question }).catch(() => ({ order: null }));
    this.asking = null;
    if (order) {
      this.work.orders++;
      this.work.records += work.records;
      this.work.moved += work.moved;
      this.known.set(question.interval, { ...question, order });
      // Orders of intervals that are not shown any more are not needed.
      if (this.known.size > 4) this.known.delete(this.known.keys().next().value);
      this.came();
    }
    this.go();
  }

  forget(interval) {
    this.known.delete(interval);
    this.helper.forget(interval);
  }
}
