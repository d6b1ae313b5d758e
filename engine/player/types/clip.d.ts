/** A container: an address, a File or another Blob, or its bytes. */
export type Source = string | URL | Blob | ArrayBuffer | ArrayBufferView<ArrayBuffer>;

export interface ClipOptions {
  /** Bytes of packets that are kept at most (64 MiB unless set). */
  room?: number;
  /** Gaussians of an interval at most (2²⁴ unless set); more are refused. */
  gaussians?: number;
  /** Ends what is under way. */
  signal?: AbortSignal | null;
}

/** Where the source's frames lie in the model's input: height and width each, row and column of the corner. */
export interface Placement {
  source: [number, number];
  model: [number, number];
  offset: [number, number];
  content: [number, number];
}

/** A scene in time: its intervals as they are needed. It draws nothing. */
export class Clip {
  static open(source: Source, options?: ClipOptions): Promise<Clip>;
  /** The scene's first and last time, in seconds. */
  readonly start: number;
  readonly end: number;
  /** Frames of the source per second. */
  readonly fps: number;
  readonly placement: Placement;
  readonly intervals: { start: number; end: number; gaussians: number }[];
  /** Requests made and bytes received so far. */
  readonly traffic: { requests: number; bytes: number };
  /** Bytes of packets in memory. */
  readonly kept: number;
  /** Whether the interval at a time is loaded. */
  has(time: number): boolean;
  /** Ends the worker. */
  close(): void;
}
