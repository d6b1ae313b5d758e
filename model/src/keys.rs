//! The names of a checkpoint's parts.

/// Prefixes that all keys of a checkpoint may have: as trained, from a compiled module, none.
pub(crate) const PREFIXES: [&str; 3] = ["model.", "model._orig_mod.", ""];
pub(crate) const ENCODER: &str = "gs_predictor.encoder.transformer_encoder";
pub(crate) const STATIC_UPSAMPLER: &str = "gs_predictor.gaussian_upsampler";
pub(crate) const STATIC_HEAD: &str = "gs_predictor.predictor";
pub(crate) const DECODER: &str = "decoder.transformer_decoder";
pub(crate) const DEFORMATION_UPSAMPLER: &str = "gaussian_upsampler";
pub(crate) const DEFORMATION_HEAD: &str = "gs_dynamic_predictor";
