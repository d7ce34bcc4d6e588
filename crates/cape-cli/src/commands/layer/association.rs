//! Options of the commands that learn from a set: association and learning.

use cape_core::SmplModel;
use cape_core::{geometry::SurfaceMesh, smpl::StandardPose};
use cape_layer::{
    AssociateOptions, Association, LayerSet,
    experiment::LearningOptions,
    regress::{FeatureOptions, TrainingOptions},
};
use clap::Args;
use serde::{Serialize, Serializer};

use crate::{
    console::Console,
    error::{Error, Result},
    options::{at_least_one, choices, non_negative, positive},
};

/// Options of the association of clothing with the body.
#[derive(Debug, Clone, Args, Serialize)]
pub(super) struct AssociationArgs {
    /// Body vertices per clothing vertex.
    #[arg(long, default_value_t = 4, value_name = "N", value_parser = at_least_one)]
    pub(super) neighbours: usize,
    /// Standard deviation σ of the influence of a pair over both meshes, mm.
    #[arg(long, default_value_t = 10.0, value_name = "MM", value_parser = positive)]
    pub(super) sigma: f64,
    /// Largest distance of the influence of a pair over either mesh, mm.
    #[arg(long, default_value_t = 30.0, value_name = "MM", value_parser = positive)]
    pub(super) support: f64,
    /// Frame of the association, counted over all sequences.
    #[arg(long, default_value_t = 0, value_name = "K")]
    pub(super) frame: usize,
    /// Pose of unposed clothing.
    #[arg(long, default_value = "a-pose", value_name = "POSE", value_parser = choices(STANDARD_POSES))]
    #[serde(serialize_with = "write_pose")]
    pub(super) standard: StandardPose,
}

impl Default for AssociationArgs {
    fn default() -> Self {
        let AssociateOptions { neighbours, sigma, support, .. } = AssociateOptions::default();
        let (sigma, support) = (1e3 * sigma, 1e3 * support);
        Self { neighbours, sigma, support, frame: 0, standard: StandardPose::A }
    }
}

/// Poses of unposed clothing by name.
const STANDARD_POSES: [(&str, StandardPose); 2] =
    [("a-pose", StandardPose::A), ("t-pose", StandardPose::T)];

fn write_pose<S: Serializer>(pose: &StandardPose, to: S) -> Result<S::Ok, S::Error> {
    let name = STANDARD_POSES.iter().find(|(_, known)| known == pose).map(|(name, _)| *name);
    name.serialize(to)
}

/// Clothing associated with the body in one frame.
pub(super) struct AssociationOutput {
    pub(super) body: SurfaceMesh,
    pub(super) clothing: SurfaceMesh,
    pub(super) association: Association,
}

impl AssociationArgs {
    pub(super) fn standard(&self) -> StandardPose {
        self.standard.clone()
    }

    pub(super) fn options(&self) -> AssociateOptions {
        AssociateOptions {
            neighbours: self.neighbours,
            sigma: 1e-3 * self.sigma,
            support: 1e-3 * self.support,
            ..AssociateOptions::default()
        }
    }

    /// Associates the set's clothing with its body, and notes warnings.
    pub(super) fn associate(
        &self,
        model: &SmplModel,
        set: &LayerSet,
        console: Console,
    ) -> Result<AssociationOutput> {
        let each = set.each_frame();
        let &(sequence, frame) = each.get(self.frame).ok_or_else(|| {
            Error::message(format!("--frame {}: the set has {} frames", self.frame, each.len()))
        })?;
        let body = set.sequences[sequence].body(model, frame, &self.standard())?;
        let body = SurfaceMesh::new("body", body.posed, model.faces.clone())?;
        let clothing = set.clothing(sequence, frame)?;
        let association = self.options().associate(&body, &clothing)?;
        for oddity in warnings(&association) {
            console
                .note(&format!("warning: sequence `{}`: {oddity}", set.sequences[sequence].name));
        }
        Ok(AssociationOutput { body, clothing, association })
    }
}

/// Problems of the meshes that do not prevent an association.
fn warnings(association: &Association) -> Vec<String> {
    let statistics = &association.statistics;
    let mut found = Vec::new();
    if statistics.clothing_is_flipped() {
        found.push(format!(
            "{} of {} rays from the body hit the clothing from outside: its faces are flipped \
             (this affects only pictures)",
            statistics.on_outer_side, statistics.hits
        ));
    }
    if statistics.inside > 0 {
        found.push(format!(
            "{} of {} clothing vertices are inside the body in the frame of the association",
            statistics.inside,
            association.clothing_vertices()
        ));
    }
    if association.completion.isolated > 0 {
        found.push(format!(
            "{} clothing vertices are in parts that no ray from the body hits: they follow the \
             nearest part that is hit",
            association.completion.isolated
        ));
    }
    found
}

/// Options of components and regression.
#[derive(Debug, Clone, Args)]
pub(super) struct LearningArgs {
    /// Number of principal components to predict [default: 40 for one sequence, 100 for several, or as
    /// many as the frames allow].
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    pub(super) components: Option<usize>,
    /// Successive rises of the validation error before training stops; 0 in the paper [default: all
    /// iterations, of which the best is kept].
    #[arg(long, value_name = "N")]
    patience: Option<usize>,
    /// Number of copies of the training frames with noise on semantic parameters, where these vary.
    #[arg(long, default_value_t = 8, value_name = "N")]
    copies: usize,
    /// Standard deviation of that noise relative to that of the parameters.
    #[arg(long, default_value_t = 0.1, value_name = "S", value_parser = non_negative)]
    noise: f64,
    /// Weight of the mean square of the network's parameters.
    #[arg(long, default_value_t = 0.0, value_name = "W", value_parser = non_negative)]
    decay: f64,
    /// Dimension that semantic parameters are reduced to, if more of them vary.
    #[arg(long, default_value_t = 4, value_name = "N", value_parser = at_least_one)]
    reduce: usize,
    /// Take garment sizes as ratios to the wearer's measurements instead of those of the body that the garment
    /// was cut for; their names are then length_ratio, width_ratio, sleeve_ratio and size_ratio.
    #[arg(long)]
    wearer_ratios: bool,
    /// Standard deviation of Gaussian smoothing of speeds in seconds.
    #[arg(long, default_value_t = 0.0, value_name = "S", value_parser = non_negative)]
    smoothing: f64,
    /// Number of earlier moments, 0.1 s apart, that the prediction depends on, for clothes that swing.
    #[arg(long, default_value_t = 0, value_name = "N", value_parser = at_most_a_hundred)]
    history: usize,
}

fn at_most_a_hundred(text: &str) -> std::result::Result<usize, String> {
    let number: usize = text.parse().map_err(|error| format!("{error}"))?;
    if number > 100 { Err("expected 0 to 100".into()) } else { Ok(number) }
}

impl LearningArgs {
    pub(super) fn learning(&self, seed: u64, trainings: usize) -> LearningOptions {
        let features = FeatureOptions {
            smoothing: self.smoothing,
            history: self.history,
            ..FeatureOptions::default()
        };
        LearningOptions {
            components: self.components,
            features,
            semantics: Some(self.reduce),
            wearer_ratios: self.wearer_ratios,
            trainings,
            training: TrainingOptions {
                patience: self.patience,
                copies: self.copies,
                noise: self.noise,
                decay: self.decay,
                seed,
                ..TrainingOptions::default()
            },
            ..LearningOptions::default()
        }
    }
}
