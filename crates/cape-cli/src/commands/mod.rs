//! One module for each command.

pub(crate) mod animate;
pub(crate) mod bench;
pub(crate) mod compare;
pub(crate) mod demo;
pub(crate) mod eval;
pub(crate) mod eval_samples;
pub(crate) mod export;
pub(crate) mod fit_prior;
pub(crate) mod generate;
pub(crate) mod import;
pub(crate) mod info;
pub(crate) mod inspect;
pub(crate) mod layer;
pub(crate) mod pack;
pub(crate) mod pose_effect;
pub(crate) mod pyramid;
pub(crate) mod redress;
pub(crate) mod sample;
pub(crate) mod synth;
pub(crate) mod table2;
pub(crate) mod train;
pub(crate) mod unpose;
pub(crate) mod vary;
#[cfg(feature = "view")]
pub(crate) mod view;
