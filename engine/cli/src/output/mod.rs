//! Results of a run: where they go, their record, and what a run that was stopped leaves to go on from.

pub mod choices;
pub mod destination;
pub mod digest;
pub mod earlier;
pub mod ledger;
pub mod outputs;
pub mod place;
pub mod record;
pub mod report;
pub mod resume_state;
pub mod terms;
