//! A page that shows a scene in a browser: splats drawn with WebGL2, at any time, from any side.
//!
//! [`Server`] serves the page and the scene's intervals on demand; [`write_page`] puts both into one file that opens by
//! itself. The page contacts no other server. Its content comes from a [`Source`]: a scene on disk ([`Recorded`]), a
//! stream under way ([`Live`]) or a still scene ([`StillSource`]). [`mod@packet`] is the form in which an interval
//! travels; a still scene has one of its own. What draws, sorts, unpacks and keeps intervals there is the player's code
//! (`engine/player`), which other pages load as a package; the page adds its controls. Files that are opened on the
//! page are read there, by the scripts in `dropped`, into the packets that a [`StillSource`] has of them.
//!
//! The page draws in the browser's arithmetic: its image is close to
//! [`Interval::render`](crate::stream::Interval::render)'s, and outside the contract of equal bits.

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
