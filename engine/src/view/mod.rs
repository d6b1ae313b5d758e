//! A page that shows a scene in a browser: splats drawn with WebGL2, at any time, from any side.
//!
//! [`Server`] serves the page and the scene's intervals on demand; [`write_page`] puts both into one file that opens
//! alone. The page contacts no other server. Its content comes from a [`Source`]: a scene on disk ([`Recorded`]), a
//! stream under way ([`Live`]) or a still scene ([`StillSource`]). [`mod@packet`] is the transfer format of an
//! interval; a still scene has a format of its own. The player (`engine/player`) unpacks, caches, sorts and draws;
//! other pages load it as a package, and this page adds its controls. Files opened on the page are read there, by the
//! scripts in `dropped`, into the packets of a [`StillSource`].
//!
//! The page draws in the browser's arithmetic: its image is close to that of
//! [`Interval::render`](crate::stream::Interval::render), and outside of the bit contract.

pub mod http;
pub mod packet;
mod page;
mod server;
mod source;
mod still;
mod text;

pub use page::{Link, PageError, Whole, poster, write_page};
pub use server::{ServeError, Server};
pub use source::{Description, IntervalTimes, Live, Recorded, Source};
pub use still::{StillDescription, StillError, StillSource};
