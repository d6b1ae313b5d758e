//! Placeholder for the code whose scenes are tested.
