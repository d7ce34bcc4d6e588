//! One module for each command, by group.

pub(crate) mod animate;
pub(crate) mod body;
pub(crate) mod data;
pub(crate) mod demo;
pub(crate) mod eval;
pub(crate) mod fit;
pub(crate) mod info;
pub(crate) mod layer;
pub(crate) mod model;
pub(crate) mod redress;
pub(crate) mod sample;
pub(crate) mod study;
pub(crate) mod table2;
pub(crate) mod train;
pub(crate) mod vary;
#[cfg(feature = "view")]
pub(crate) mod view;
