//! What commands that learn from a set have in common: tying clothing to the body, and settings.

use cape_core::SmplModel;
use cape_core::{geometry::SurfaceMesh, smpl::StandardPose};
use cape_layer::{
    AssociateOptions, Association, LayerSet,
    experiment::LearningOptions,
    regress::{FeatureOptions, TrainingOptions},
};
use clap::{Args, ValueEnum};
use serde::Serialize;

use crate::{
    arguments::at_least_one,
    console::Console,
    error::{Error, Result},
};

/// How clothing is tied to the body.
#[derive(Debug, Clone, Args, Serialize)]
pub(super) struct AssociationArgs {
    /// Body vertices for each clothing vertex.
    #[arg(long, default_value_t = 4, value_name = "N", value_parser = at_least_one)]
    pub(super) neighbours: usize,
    /// How far a pair of body and clothing vertex is felt, σ, over both meshes, millimetres.
    #[arg(long, default_value_t = 10.0, value_name = "MM")]
    pub(super) sigma: f64,
    /// Distance over either mesh beyond which it is not, millimetres.
    #[arg(long, default_value_t = 30.0, value_name = "MM")]
    pub(super) support: f64,
    /// Frame, counted over all sequences, in which clothing is tied to the body.
    #[arg(long, default_value_t = 0, value_name = "K")]
    pub(super) frame: usize,
    /// The pose that clothing is brought to.
    #[arg(long, value_enum, default_value_t = StandardPoseName::APose)]
    pub(super) standard: StandardPoseName,
}

impl Default for AssociationArgs {
    fn default() -> Self {
        let AssociateOptions { neighbours, sigma, support, .. } = AssociateOptions::default();
        let (sigma, support) = (1e3 * sigma, 1e3 * support);
        Self { neighbours, sigma, support, frame: 0, standard: StandardPoseName::APose }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum StandardPoseName {
    APose,
    TPose,
}

/// Clothing tied to the body in one frame.
pub(super) struct AssociationOutput {
    pub(super) body: SurfaceMesh,
    pub(super) clothing: SurfaceMesh,
    pub(super) association: Association,
}

impl AssociationArgs {
    pub(super) fn standard(&self) -> StandardPose {
        match self.standard {
            StandardPoseName::APose => StandardPose::A,
            StandardPoseName::TPose => StandardPose::T,
        }
    }

    pub(super) fn options(&self) -> AssociateOptions {
        AssociateOptions {
            neighbours: self.neighbours,
            sigma: 1e-3 * self.sigma,
            support: 1e-3 * self.support,
            ..AssociateOptions::default()
        }
    }

    /// Ties the set's clothing to its body, and says what is odd about them.
    pub(super) fn associate(
        &self,
        model: &SmplModel,
        set: &LayerSet,
        console: Console,
    ) -> Result<AssociationOutput> {
        let each = set.each_frame();
        let &(sequence, frame) = each.get(self.frame).ok_or_else(|| {
            Error::message(format!("--frame {}: there are {}", self.frame, each.len()))
        })?;
        let body = set.sequences[sequence].body(model, frame, &self.standard())?;
        let body = SurfaceMesh::new("body", body.posed, model.faces.clone())?;
        let clothing = set.clothing(sequence, frame)?;
        let association = self.options().associate(&body, &clothing)?;
        for oddity in warnings(&association) {
            console.note(&format!("sequence `{}`: {oddity}", set.sequences[sequence].name));
        }
        Ok(AssociationOutput { body, clothing, association })
    }
}

/// What the rays from the body say about meshes that can be used but may not be meant.
fn warnings(association: &Association) -> Vec<String> {
    let statistics = &association.statistics;
    let mut found = Vec::new();
    if statistics.clothing_is_flipped() {
        found.push(format!(
            "{} of {} rays from the body meet the clothing's outer side: its faces are flipped \
             (they only matter for pictures)",
            statistics.on_outer_side, statistics.hits
        ));
    }
    if statistics.inside > 0 {
        found.push(format!(
            "{} of {} clothing vertices are inside the body in the frame that ties them",
            statistics.inside,
            association.clothing_vertices()
        ));
    }
    if association.completion.isolated > 0 {
        found.push(format!(
            "{} clothing vertices are in parts that no ray from the body meets: they follow the \
             nearest part that is met",
            association.completion.isolated
        ));
    }
    found
}

/// How clothing is learned.
#[derive(Debug, Clone, Args)]
pub(super) struct LearningArgs {
    /// Principal components that are predicted.
    #[arg(long, default_value_t = 40, value_name = "N", value_parser = at_least_one)]
    pub(super) components: usize,
    /// Rises of the validation error in a row after which training still goes on.
    #[arg(long, default_value_t = 0, value_name = "N")]
    patience: usize,
    /// Copies of the training frames with noise on the semantic parameters.
    #[arg(long, default_value_t = 0, value_name = "N")]
    copies: usize,
    /// Standard deviation of that noise, relative to that of the parameters.
    #[arg(long, default_value_t = 0.05, value_name = "S")]
    noise: f64,
    /// Numbers that semantic parameters are reduced to if more of them vary.
    #[arg(long, default_value_t = 4, value_name = "N", value_parser = at_least_one)]
    reduce: usize,
    /// Standard deviation of the Gaussian that smooths speeds, seconds.
    #[arg(long, default_value_t = 0.0, value_name = "S")]
    smoothing: f64,
}

impl LearningArgs {
    pub(super) fn learning(&self, seed: u64) -> Result<LearningOptions> {
        if !(self.smoothing.is_finite() && self.smoothing >= 0.0) {
            let message = format!("--smoothing {}: expected 0 or more", self.smoothing);
            return Err(Error::message(message));
        }
        Ok(LearningOptions {
            components: self.components,
            features: FeatureOptions { smoothing: self.smoothing, ..FeatureOptions::default() },
            semantics: Some(self.reduce),
            training: TrainingOptions {
                patience: self.patience,
                copies: self.copies,
                noise: self.noise,
                seed,
                ..TrainingOptions::default()
            },
        })
    }
}
