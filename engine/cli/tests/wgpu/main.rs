//! Drawing with a graphics card, on any adapter. `tests/outside/wgpu/run` installs a software one and runs this.

mod images;
mod program;
