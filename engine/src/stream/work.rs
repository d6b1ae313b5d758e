//! Counts of work done and work avoided, per stage.

use std::time::Duration;

/// One stage's account.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StageWork {
    /// The stage's name.
    pub stage: &'static str,
    /// Work done, in `unit`.
    pub done: u64,
    /// Work that was not needed, in `unit`.
    pub avoided: u64,
    /// What is counted.
    pub unit: &'static str,
    /// Time spent in the stage.
    pub time: Duration,
}

/// The account of an engine, stages in the order of the stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Work {
    stages: Vec<StageWork>,
}

/// The stages of the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stage {
    Fit,
    Encoder,
    Static,
    Condition,
    Deformation,
    Fusion,
}

impl Stage {
    const ALL: [(Stage, &'static str, &'static str); 6] = [
        (Stage::Fit, "fit", "frames"),
        (Stage::Encoder, "encoder", "frames"),
        (Stage::Static, "static", "frames"),
        (Stage::Condition, "condition", "frames"),
        (Stage::Deformation, "deformation", "pairs"),
        (Stage::Fusion, "fusion", "intervals"),
    ];
}

impl Default for Work {
    fn default() -> Self {
        let stages =
            Stage::ALL.map(|(_, stage, unit)| StageWork { stage, done: 0, avoided: 0, unit, time: Duration::ZERO });
        Self { stages: stages.to_vec() }
    }
}

impl Work {
    /// The stages, in the order of the stream.
    pub fn stages(&self) -> &[StageWork] {
        &self.stages
    }

    /// The stage of this name.
    pub fn stage(&self, name: &str) -> Option<&StageWork> {
        self.stages.iter().find(|s| s.stage == name)
    }

    /// Counts `done` and `avoided` units of a stage.
    pub(crate) fn count(&mut self, stage: Stage, done: u64, avoided: u64) {
        let stage = &mut self.stages[stage as usize];
        stage.done += done;
        stage.avoided += avoided;
    }

    /// Runs `work` as one unit of a stage, inside a tracing span of its name.
    pub(crate) fn measure<R>(&mut self, stage: Stage, work: impl FnOnce() -> R) -> R {
        let entry = &mut self.stages[stage as usize];
        let _span = tracing::info_span!("stage", name = entry.stage).entered();
        let start = std::time::Instant::now();
        let result = work();
        entry.time += start.elapsed();
        entry.done += 1;
        result
    }
}
