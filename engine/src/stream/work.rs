//! Counts of work done and work avoided, per stage.

use std::time::Duration;

use streamsplat_model::reuse::Tokens;
use streamsplat_model::zero_output::ZeroOutput;

/// One stage's account.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StageWork {
    /// The stage's name.
    pub stage: &'static str,
    /// Work done, in `unit`.
    pub done: u64,
    /// Work that was left out, in `unit`.
    pub avoided: u64,
    /// Unit of the counts.
    pub unit: &'static str,
    /// Time spent in the stage, summed over tiles, which run at the same time; zero for a part of another stage.
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
    Upsampler,
    Heads,
    Condition,
    Decoder,
    Flow,
    Parallax,
    Guess,
    Lift,
    Outline,
    Behind,
    Covered,
    Detail,
    Fusion,
    Colours,
    Still,
    Patches,
}

impl Stage {
    const ALL: [(Stage, &'static str, &'static str); 18] = [
        (Stage::Fit, "fit", "frames"),
        (Stage::Encoder, "encoder", "tiles"),
        (Stage::Upsampler, "upsampler", "tiles"),
        (Stage::Heads, "heads", "tiles"),
        (Stage::Condition, "dinov2", "tiles"),
        (Stage::Decoder, "decoder", "pairs of tiles"),
        (Stage::Flow, "flow", "pairs of frames"),
        (Stage::Parallax, "parallax", "intervals"),
        (Stage::Guess, "guess", "intervals"),
        (Stage::Lift, "lift", "frames"),
        (Stage::Outline, "outline", "Gaussians"),
        (Stage::Behind, "behind", "Gaussians"),
        (Stage::Covered, "covered", "Gaussians"),
        (Stage::Detail, "detail", "Gaussians"),
        (Stage::Fusion, "fusion", "intervals"),
        (Stage::Colours, "colours", "steps"),
        (Stage::Still, "still", "blocks"),
        (Stage::Patches, "patches", "patches"),
    ];
}

impl Stage {
    /// The network's stages have spans of their own.
    pub(super) fn span(self) -> tracing::Span {
        match self {
            Stage::Fit => tracing::info_span!("fit"),
            Stage::Fusion => tracing::info_span!("fusion"),
            Stage::Flow => tracing::info_span!("flow"),
            Stage::Parallax => tracing::info_span!("parallax"),
            Stage::Lift => tracing::info_span!("lift"),
            Stage::Colours => tracing::info_span!("colours"),
            _ => tracing::Span::none(),
        }
    }
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

    /// Sets the accounts of the network's parts in tokens, each under its stage's name and `.tokens`.
    pub(crate) fn tokens(&mut self, parts: &[(&'static str, Tokens)]) {
        for (part, tokens) in parts {
            let name = match *part {
                "encoder" => "encoder.tokens",
                "upsampler" => "upsampler.tokens",
                "decoder" => "decoder.tokens",
                "dinov2" => "dinov2.tokens",
                _ => "heads.tokens",
            };
            let Tokens { done, avoided } = *tokens;
            self.replace(StageWork { stage: name, done, avoided, unit: "tokens of a block", time: Duration::ZERO });
        }
    }

    /// Sets the accounts of the network's residual branches, each under its stage's name and `.branches`: one branch
    /// for every call of a part so far. `zero_output` has the ones left out; without any, nothing is set.
    pub(crate) fn branches(&mut self, zero_output: &[ZeroOutput]) {
        if zero_output.iter().all(|part| part.zero_output == 0) {
            return;
        }
        let calls = |stage: Stage| self.stages[stage as usize].done;
        let accounts = [
            // Upsampled are every embedding and both outputs of the decoder.
            ("encoder.branches", [("encoder", calls(Stage::Encoder)), ("", 0)]),
            (
                "upsampler.branches",
                [("static upsampler", calls(Stage::Encoder)), ("deformation upsampler", 2 * calls(Stage::Decoder))],
            ),
            ("decoder.branches", [("decoder", calls(Stage::Decoder)), ("", 0)]),
        ];
        for (stage, parts) in accounts {
            let (mut done, mut avoided) = (0, 0);
            for part in zero_output {
                let calls: u64 = parts.iter().filter(|(name, _)| *name == part.part).map(|(_, calls)| calls).sum();
                done += calls * (part.branches - part.zero_output) as u64;
                avoided += calls * part.zero_output as u64;
            }
            self.replace(StageWork { stage, done, avoided, unit: "branches", time: Duration::ZERO });
        }
    }

    /// Sets an account that belongs to no stage of the stream.
    fn replace(&mut self, account: StageWork) {
        match self.stages.iter_mut().find(|stage| stage.stage == account.stage) {
            Some(stage) => *stage = account,
            None => self.stages.push(account),
        }
    }

    /// Counts `done` and `avoided` units of a stage.
    pub(crate) fn count(&mut self, stage: Stage, done: u64, avoided: u64) {
        let stage = &mut self.stages[stage as usize];
        stage.done += done;
        stage.avoided += avoided;
    }

    /// Adds the counts and times of another account of the stream's stages.
    pub(crate) fn add(&mut self, other: &Work) {
        for (stage, other) in self.stages.iter_mut().zip(&other.stages) {
            stage.done += other.done;
            stage.avoided += other.avoided;
            stage.time += other.time;
        }
    }

    /// Adds the time of work that ran at the same time as other stages.
    pub(crate) fn spent(&mut self, stage: Stage, time: Duration) {
        self.stages[stage as usize].time += time;
    }

    /// Runs `work` as one unit of a stage, inside its tracing span.
    pub(crate) fn measure<R>(&mut self, stage: Stage, work: impl FnOnce() -> R) -> R {
        let result = self.time(stage, work);
        self.count(stage, 1, 0);
        result
    }

    /// Runs `work` in the time and the span of a stage, without counting it as a unit.
    pub(crate) fn time<R>(&mut self, stage: Stage, work: impl FnOnce() -> R) -> R {
        let entry = &mut self.stages[stage as usize];
        let _span = stage.span().entered();
        let start = std::time::Instant::now();
        let result = work();
        entry.time += start.elapsed();
        result
    }
}
