use cape_core::OutfitVocabulary;
use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Negative slope of every leaky ReLU of the networks.
pub const LEAKY_SLOPE: f64 = 0.2;
/// Largest number of groups of a group normalisation by the release's rule.
const MAX_GROUPS: usize = 32;
/// Channels of a group in this project's presets.
const GROUP_CHANNELS: usize = 8;
/// Length of the pose feature: the rotation matrices of the 14 joints that move clothing.
pub const POSE_FEATURE: usize = 126;

/// Kind of the decoder's blocks (CAPE §4.1 and appendix A; CoMA).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DecoderBlock {
    /// Conditional residual blocks with group normalisation, after GraphCMR.
    Residual,
    /// `relu(cheb(x)) + linear(x)` at half the width, as in CAPE-affine.
    Affine,
    /// Convolution, bias and leaky ReLU, as in CoMA.
    Plain,
}

/// Places of the decoder that receive the conditions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DecoderConditions {
    /// None: an unconditional model.
    None,
    /// The latent code only.
    Latent,
    /// The latent code and, at every vertex, the input of every block.
    Everywhere,
}

/// Architecture of the generator and the discriminator (CAPE appendix A).
///
/// ```
/// use cape_model::{CapeConfig, DecoderBlock, DecoderConditions, DiscriminatorConfig, Error};
///
/// let config = CapeConfig {
///     decoder: DecoderBlock::Plain,
///     decoder_conditions: DecoderConditions::Latent,
///     discriminator: Some(DiscriminatorConfig { spectral_norm: true, ..Default::default() }),
///     ..CapeConfig::preset("paper")?
/// };
/// config.validate()?;
/// assert_eq!(config.condition_size(), 24 + 8);
///
/// let wrong = CapeConfig { latent: 0, ..config };
/// assert!(matches!(wrong.validate(), Err(Error::Config { field, .. }) if field == "latent"));
/// # Ok::<(), cape_model::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(clippy::struct_excessive_bools, reason = "independent switches of the architecture")]
pub struct CapeConfig {
    /// Output channels of every encoder convolution; the decoder mirrors them.
    pub filters: Vec<usize>,
    /// Down-sampling factor after every encoder convolution; 1 keeps the mesh.
    pub factors: Vec<u32>,
    /// Chebyshev terms `K` of the generator's convolutions.
    pub order: usize,
    /// Size of the latent code `z`.
    pub latent: usize,
    /// Channels of the 1×1 convolution before the encoder's heads; 0 omits it.
    pub reduce: usize,
    /// Fully connected layers of the pose condition net, 1 or 2.
    pub pose_layers: usize,
    /// Size of the pose embedding; 0 removes the condition.
    pub pose_embedding: usize,
    /// Outfits of the one-hot label, in its order; the paper's four by default.
    #[serde(default, skip_serializing_if = "OutfitVocabulary::is_paper")]
    pub outfits: OutfitVocabulary,
    /// Fully connected layers of the outfit condition net, 1 or 2.
    pub outfit_layers: usize,
    /// Size of the outfit embedding; 0 removes the condition.
    pub outfit_embedding: usize,
    /// True if the conditions are appended at every vertex of the encoder's input.
    pub encoder_conditions: bool,
    /// True if the encoder consists of residual blocks.
    pub encoder_residual: bool,
    /// Kind of the decoder's blocks.
    pub decoder: DecoderBlock,
    /// Places of the decoder that receive the conditions.
    pub decoder_conditions: DecoderConditions,
    /// True if the decoder adds a linear function of the code and its conditions to the displacements
    /// of all vertices, which have detail of their own then from the first step on.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub linear_path: bool,
    /// True for a VAE, whose code is sampled in training; false for an auto-encoder, whose code is
    /// the mean.
    pub variational: bool,
    /// Standard deviation of the initial weights of the convolutions. CAPE's 0.1 suits its widths;
    /// narrower models need a larger one, or the signal vanishes in the encoder.
    #[serde(default = "default_deviation")]
    pub deviation: f64,
    /// Channels that a group of the group normalisations has at least; `None` is the release's rule of
    /// `min(32, channels)` groups. At this project's small widths that rule leaves one channel in a
    /// group, which subtracts conditions that are constant over the vertices.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub group_channels: Option<usize>,
    /// Patchwise discriminator; `None` trains without one.
    pub discriminator: Option<DiscriminatorConfig>,
}

/// Architecture of the discriminator (CAPE §4.1).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DiscriminatorConfig {
    /// Output channels of every convolution.
    pub filters: Vec<usize>,
    /// Down-sampling factor after every convolution.
    pub factors: Vec<u32>,
    /// Chebyshev terms `K` of the convolutions.
    pub order: usize,
    /// Chebyshev terms of the last, one-channel convolution.
    pub output_order: usize,
    /// True for spectral normalisation: weight matrices are divided by their largest singular value
    /// (Miyato et al. 2018).
    #[serde(default)]
    pub spectral_norm: bool,
}

const fn default_deviation() -> f64 {
    0.1
}

impl Default for DiscriminatorConfig {
    fn default() -> Self {
        Self {
            filters: vec![64, 64, 128, 128],
            factors: vec![2, 2, 2, 2],
            order: 3,
            output_order: 2,
            spectral_norm: false,
        }
    }
}

impl Default for CapeConfig {
    fn default() -> Self {
        Self::paper()
    }
}

impl CapeConfig {
    /// The paper's model: 8 layers, 18 latent dimensions, residual blocks.
    pub fn paper() -> Self {
        Self {
            filters: vec![64, 64, 128, 128, 256, 256, 512, 512],
            factors: vec![1, 2, 1, 2, 1, 2, 1, 1],
            order: 2,
            latent: 18,
            reduce: 64,
            pose_layers: 2,
            pose_embedding: 24,
            outfits: OutfitVocabulary::default(),
            outfit_layers: 1,
            outfit_embedding: 8,
            encoder_conditions: false,
            encoder_residual: false,
            decoder: DecoderBlock::Residual,
            decoder_conditions: DecoderConditions::Everywhere,
            linear_path: false,
            variational: true,
            deviation: default_deviation(),
            group_channels: None,
            discriminator: Some(DiscriminatorConfig::default()),
        }
    }

    /// The larger model that the authors recommend for detail: affine blocks, 64 latent dimensions.
    pub fn detail() -> Self {
        Self {
            latent: 64,
            pose_embedding: 32,
            outfit_embedding: 32,
            decoder: DecoderBlock::Affine,
            ..Self::paper()
        }
    }

    /// The paper's model at a quarter to a half of its widths, with about a tenth of its
    /// operations.
    pub fn narrow() -> Self {
        Self {
            filters: vec![32, 32, 32, 32, 64, 64, 128, 128],
            reduce: 32,
            deviation: 0.2,
            group_channels: Some(GROUP_CHANNELS),
            discriminator: Some(DiscriminatorConfig {
                filters: vec![16, 16, 32, 32],
                ..DiscriminatorConfig::default()
            }),
            ..Self::paper()
        }
    }

    /// The [`narrow`](Self::narrow) model with affine blocks, as [`detail`](Self::detail), 32 latent
    /// dimensions and a linear path, whose weights a smaller `reduce` saves: the built-in model's.
    pub fn small() -> Self {
        Self {
            latent: 32,
            reduce: 16,
            decoder: DecoderBlock::Affine,
            linear_path: true,
            ..Self::narrow()
        }
    }

    /// A model of four narrow layers for tests on small meshes.
    pub fn tiny() -> Self {
        Self {
            filters: vec![8, 16, 16, 8],
            factors: vec![1, 2, 1, 1],
            latent: 6,
            reduce: 4,
            pose_embedding: 6,
            outfit_embedding: 2,
            group_channels: Some(GROUP_CHANNELS),
            discriminator: Some(DiscriminatorConfig {
                filters: vec![8, 16],
                factors: vec![2, 2],
                ..DiscriminatorConfig::default()
            }),
            ..Self::paper()
        }
    }

    /// The preset called `name`: `paper`, `detail`, `small`, `narrow` or `tiny`.
    pub fn preset(name: &str) -> Result<Self> {
        match name {
            "paper" => Ok(Self::paper()),
            "detail" => Ok(Self::detail()),
            "small" => Ok(Self::small()),
            "narrow" => Ok(Self::narrow()),
            "tiny" => Ok(Self::tiny()),
            _ => Err(Error::Config {
                field: "preset".into(),
                message: format!(
                    "unknown preset `{name}`: expected paper, detail, small, narrow or tiny"
                ),
            }),
        }
    }

    /// Length of the embedded conditions: pose and outfit embedding together.
    pub fn condition_size(&self) -> usize {
        self.pose_embedding + self.outfit_embedding
    }

    /// Checks the values of all fields and their relations; errors name the field.
    pub fn validate(&self) -> Result<()> {
        let error =
            |field: &str, message: String| Err(Error::Config { field: field.into(), message });
        check_layers("filters", &self.filters, "factors", &self.factors)?;
        if self.order == 0 {
            return error("order", "must be at least 1".into());
        }
        if !(self.deviation.is_finite() && self.deviation > 0.0) {
            return error("deviation", format!("must be positive, not {}", self.deviation));
        }
        if self.latent == 0 {
            return error("latent", "must be at least 1".into());
        }
        for (field, layers) in
            [("pose_layers", self.pose_layers), ("outfit_layers", self.outfit_layers)]
        {
            if !(1..=2).contains(&layers) {
                return error(field, format!("must be 1 or 2, not {layers}"));
            }
        }
        let conditions = self.condition_size();
        if conditions == 0
            && (self.decoder_conditions != DecoderConditions::None || self.encoder_conditions)
        {
            return error(
                "decoder_conditions",
                "needs a pose or outfit embedding: set it to \"none\", and encoder_conditions to false".into(),
            );
        }
        if self.decoder != DecoderBlock::Plain
            && let Some(odd) = self.filters.iter().find(|f| *f % 2 != 0)
        {
            return error("filters", format!("must be even for this decoder, not {odd}"));
        }
        if self.group_channels == Some(0) {
            return error("group_channels", "must be at least 1".into());
        }
        if self.decoder == DecoderBlock::Residual {
            for channels in self.normalised_channels() {
                let groups = group_count(channels, self.group_channels);
                if channels % groups != 0 {
                    return error(
                        "filters",
                        format!(
                            "must give multiples of {groups} for group normalisation, not {channels} \
                             channels (filters, pose_embedding, outfit_embedding)"
                        ),
                    );
                }
            }
        }
        if let Some(discriminator) = &self.discriminator {
            check_layers(
                "discriminator.filters",
                &discriminator.filters,
                "discriminator.factors",
                &discriminator.factors,
            )?;
            if discriminator.order == 0 || discriminator.output_order == 0 {
                return error("discriminator.order", "must be at least 1".into());
            }
        }
        Ok(())
    }

    /// Channels appended at every vertex before every decoder block.
    pub(crate) fn block_conditions(&self) -> usize {
        match self.decoder_conditions {
            DecoderConditions::Everywhere => self.condition_size(),
            _ => 0,
        }
    }

    fn normalised_channels(&self) -> Vec<usize> {
        let extra = self.block_conditions();
        let mut input = self.filters.last().copied().unwrap_or_default();
        let mut channels = Vec::new();
        for &filters in self.filters.iter().rev() {
            channels.extend([input + extra, filters / 2]);
            input = filters;
        }
        channels
    }
}

/// Number of groups of a group normalisation of `channels` channels.
pub(crate) fn group_count(channels: usize, group_channels: Option<usize>) -> usize {
    match group_channels {
        Some(size) => (channels / size.max(1)).max(1),
        None => channels.min(MAX_GROUPS),
    }
}

fn check_layers(
    filters_field: &str,
    filters: &[usize],
    factors_field: &str,
    factors: &[u32],
) -> Result<()> {
    let error = |field: &str, message: String| Err(Error::Config { field: field.into(), message });
    if filters.is_empty() || filters.contains(&0) {
        return error(filters_field, "must list at least one layer of at least 1 channel".into());
    }
    if factors.len() != filters.len() {
        return error(
            factors_field,
            format!("has {} entries but `{filters_field}` has {}", factors.len(), filters.len()),
        );
    }
    if factors.contains(&0) {
        return error(factors_field, "must all be at least 1".into());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid() {
        for name in ["paper", "detail", "narrow", "tiny"] {
            CapeConfig::preset(name).unwrap().validate().unwrap();
        }
        assert!(CapeConfig::preset("huge").is_err());
    }

    #[test]
    fn groups_have_the_configured_channels() {
        assert_eq!([3, 32, 288].map(|channels| group_count(channels, None)), [3, 32, 32]);
        assert_eq!([4, 16, 20, 96].map(|channels| group_count(channels, Some(8))), [1, 2, 2, 12]);
        let odd = CapeConfig { group_channels: Some(7), ..CapeConfig::narrow() };
        assert!(odd.validate().unwrap_err().to_string().contains("group normalisation"));
        let none = CapeConfig { group_channels: Some(0), ..CapeConfig::narrow() };
        assert!(none.validate().unwrap_err().to_string().contains("group_channels"));
    }

    #[test]
    fn errors_name_the_field() {
        let broken = CapeConfig { factors: vec![1, 2], ..CapeConfig::paper() };
        assert!(broken.validate().unwrap_err().to_string().contains("factors"));
        let broken = CapeConfig { pose_embedding: 25, ..CapeConfig::paper() };
        assert!(broken.validate().unwrap_err().to_string().contains("group normalisation"));
        let broken = CapeConfig { pose_embedding: 0, outfit_embedding: 0, ..CapeConfig::paper() };
        assert!(broken.validate().unwrap_err().to_string().contains("decoder_conditions"));
    }
}
