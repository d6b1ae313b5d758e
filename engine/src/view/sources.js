// Where the page's intervals come from: this file, the server, a file that was opened.

/** A scene inside this file: its intervals are texts that follow the scripts, and may be still to come. */
class Embedded extends Chunked {
  constructor(element, helper) {
    super(JSON.parse(element.textContent), helper);
  }

  /** The text of interval i, once the browser has read it to its end. */
  part(i) {
    const whole = () => {
      const element = document.getElementById(`interval-${i}`);
      if (element && (element.nextSibling || document.readyState !== "loading")) return element.textContent;
      if (document.readyState !== "loading") throw new Error("the file ends before it");
      return null;
    };
    return new Promise((done, failed) => {
      const look = () => {
        try {
          const text = whole();
          if (text === null) setTimeout(look, 20);
          else done(text);
        } catch (e) {
          failed(e);
        }
      };
      look();
    });
  }

  /** Chunks of texts: each after its key frame and whether it is independent. */
  async parts(interval, from) {
    const parts = [];
    for (let i = interval; i >= from && !parts[0]?.alone; i--) {
      const whole = bytesOf(await this.part(i));
      parts.unshift({ bytes: whole.subarray(9), index: new DataView(whole.buffer).getBigUint64(0, true), alone: whole[8] === 1, count: null });
    }
    return parts;
  }

  async packet(interval) {
    if (!this.description.still) return super.packet(interval);
    const { buffer } = await this.helper.ask({ kind: "still", interval, text: await this.part(interval) });
    return packetIn(buffer);
  }
}

/** A scene behind the server this page came from. */
class Served {
  constructor(helper) {
    this.helper = helper;
  }

  async get(path) {
    const response = await fetch(path);
    if (!response.ok) throw new Error((await response.text()).trim());
    return response;
  }

  async describe(from) {
    return (await this.get(`scene.json?from=${from}`)).json();
  }

  async packet(interval) {
    const bytes = await (await this.get(`interval/${interval}`)).arrayBuffer();
    const { buffer } = await this.helper.ask({ kind: "packet", interval, buffer: bytes }, [bytes]);
    return packetIn(buffer);
  }
}

/** A still scene from a file that was opened on the page: its packet is at hand. */
class Local {
  constructor(title, packet, still) {
    this.description = { title, fps: 0, still, live: false, complete: true, first: 0, intervals: [{ start: 0, end: 0, gaussians: packet.count }] };
    this.whole = packet;
  }

  async describe(from) {
    return { ...this.description, from, intervals: this.description.intervals.slice(from) };
  }

  async packet() {
    return this.whole;
  }
}
