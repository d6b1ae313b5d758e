//! Commands, one file or folder each.

pub mod bench;
pub mod compare;
pub mod eval;
pub mod export;
pub mod golden;
pub mod inspect;
pub mod manual;
pub mod render;
pub mod run;
pub mod still;
pub mod track;
pub mod verify;
pub mod view;
