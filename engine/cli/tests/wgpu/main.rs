//! Drawing with a graphics card, on whatever adapter there is. `tests/outside/wgpu/run` installs a software one and
//! runs this.

mod images;
mod program;
