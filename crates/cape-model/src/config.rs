use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Slope of every leaky ReLU of the networks.
pub const LEAKY_SLOPE: f64 = 0.2;
/// Groups of a group normalisation with at least as many channels.
pub(crate) const MAX_GROUPS: usize = 32;
/// Length of the pose feature: 14 rotation matrices.
pub const POSE_FEATURE: usize = 126;
/// Length of the outfit label.
pub const OUTFITS: usize = 4;

/// What the decoder is made of (CAPE §4 and appendix A; CoMA).
///
/// See [`CapeConfig`] for an example.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DecoderBlock {
    /// Conditional residual blocks with group normalisation, after GraphCMR.
    Residual,
    /// `relu(cheb(x)) + linear(x)` at half the width: "CAPE-affine".
    Affine,
    /// Convolution, bias and leaky ReLU: CoMA's.
    Plain,
}

/// Where the decoder sees the conditions.
///
/// See [`CapeConfig`] for an example.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DecoderConditions {
    /// Nowhere: an unconditional model.
    None,
    /// Beside the latent code only.
    Latent,
    /// Beside the latent code, and appended at every vertex before every block.
    Everywhere,
}

/// Architecture of the generator and the discriminator; every number of CAPE's appendix A.
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
pub struct CapeConfig {
    /// Output channels of each encoder convolution; the decoder mirrors them.
    pub filters: Vec<usize>,
    /// Down-sampling factor after each encoder convolution; 1 keeps the mesh.
    pub factors: Vec<u32>,
    /// Chebyshev terms `K` of the generator's convolutions.
    pub order: usize,
    /// Size of the latent code `z`.
    pub latent: usize,
    /// Channels of the 1×1 convolution before the encoder's heads; 0 leaves it out.
    pub reduce: usize,
    /// Fully connected layers of the pose condition net, 1 or 2.
    pub pose_layers: usize,
    /// Size of the pose embedding; 0 removes the condition.
    pub pose_embedding: usize,
    /// Fully connected layers of the outfit condition net, 1 or 2.
    pub outfit_layers: usize,
    /// Size of the outfit embedding; 0 removes the condition.
    pub outfit_embedding: usize,
    /// Whether the encoder's input has the conditions appended at every vertex.
    pub encoder_conditions: bool,
    /// Whether the encoder is made of residual blocks.
    pub encoder_residual: bool,
    /// What the decoder is made of.
    pub decoder: DecoderBlock,
    /// Where the decoder sees the conditions.
    pub decoder_conditions: DecoderConditions,
    /// Whether the latent code is sampled in training (a VAE) or is the mean (an auto-encoder).
    pub variational: bool,
    /// Standard deviation of the convolutions' initial weights. CAPE's 0.1 suits its widths: the
    /// signal fades through the encoder of a narrower model, which needs more.
    #[serde(default = "default_deviation")]
    pub deviation: f64,
    /// The patchwise discriminator, if any.
    pub discriminator: Option<DiscriminatorConfig>,
}

/// Architecture of the discriminator.
///
/// See [`CapeConfig`] for an example.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DiscriminatorConfig {
    /// Output channels of each convolution.
    pub filters: Vec<usize>,
    /// Down-sampling factor after each convolution.
    pub factors: Vec<u32>,
    /// Chebyshev terms of the convolutions.
    pub order: usize,
    /// Chebyshev terms of the last, one-channel convolution.
    pub output_order: usize,
    /// Whether weight matrices are divided by their largest singular value (Miyato et al. 2018).
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
    /// The paper's model: 8 layers, 18 latent numbers, residual blocks.
    pub fn paper() -> Self {
        Self {
            filters: vec![64, 64, 128, 128, 256, 256, 512, 512],
            factors: vec![1, 2, 1, 2, 1, 2, 1, 1],
            order: 2,
            latent: 18,
            reduce: 64,
            pose_layers: 2,
            pose_embedding: 24,
            outfit_layers: 1,
            outfit_embedding: 8,
            encoder_conditions: false,
            encoder_residual: false,
            decoder: DecoderBlock::Residual,
            decoder_conditions: DecoderConditions::Everywhere,
            variational: true,
            deviation: default_deviation(),
            discriminator: Some(DiscriminatorConfig::default()),
        }
    }

    /// The larger model its authors recommend for detail: affine blocks, 64 latent numbers.
    pub fn detail() -> Self {
        Self {
            latent: 64,
            pose_embedding: 32,
            outfit_embedding: 32,
            decoder: DecoderBlock::Affine,
            ..Self::paper()
        }
    }

    /// The paper's eight levels at a quarter to a half of its widths: about a tenth of the
    /// arithmetic.
    pub fn narrow() -> Self {
        Self {
            filters: vec![32, 32, 32, 32, 64, 64, 128, 128],
            reduce: 32,
            deviation: 0.2,
            discriminator: Some(DiscriminatorConfig {
                filters: vec![16, 16, 32, 32],
                ..DiscriminatorConfig::default()
            }),
            ..Self::paper()
        }
    }

    /// Four narrow layers, for tests on small meshes.
    pub fn tiny() -> Self {
        Self {
            filters: vec![8, 16, 16, 8],
            factors: vec![1, 2, 1, 1],
            latent: 6,
            reduce: 4,
            pose_embedding: 6,
            outfit_embedding: 2,
            discriminator: Some(DiscriminatorConfig {
                filters: vec![8, 16],
                factors: vec![2, 2],
                ..DiscriminatorConfig::default()
            }),
            ..Self::paper()
        }
    }

    /// The preset of that name: `paper`, `detail`, `narrow` or `tiny`.
    pub fn preset(name: &str) -> Result<Self> {
        match name {
            "paper" => Ok(Self::paper()),
            "detail" => Ok(Self::detail()),
            "narrow" => Ok(Self::narrow()),
            "tiny" => Ok(Self::tiny()),
            _ => Err(Error::Config {
                field: "preset".into(),
                message: format!("unknown preset `{name}`: expected paper, detail, narrow or tiny"),
            }),
        }
    }

    /// Length of both embeddings together.
    pub fn condition_size(&self) -> usize {
        self.pose_embedding + self.outfit_embedding
    }

    /// Checks what the types cannot say; errors name the field.
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
                "a model without embeddings cannot be conditioned: set it to \"none\"".into(),
            );
        }
        if self.decoder != DecoderBlock::Plain
            && let Some(odd) = self.filters.iter().find(|f| *f % 2 != 0)
        {
            return error("filters", format!("must be even for this decoder, found {odd}"));
        }
        if self.decoder == DecoderBlock::Residual {
            for channels in self.normalised_channels() {
                let groups = channels.min(MAX_GROUPS);
                if channels % groups != 0 {
                    return error(
                        "filters",
                        format!(
                            "group normalisation of {channels} channels needs a multiple of {groups}"
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

    /// Channels appended at every vertex before each decoder block.
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

fn check_layers(
    filters_field: &str,
    filters: &[usize],
    factors_field: &str,
    factors: &[u32],
) -> Result<()> {
    let error = |field: &str, message: String| Err(Error::Config { field: field.into(), message });
    if filters.is_empty() || filters.contains(&0) {
        return error(filters_field, "needs at least one layer, each of at least 1 channel".into());
    }
    if factors.len() != filters.len() {
        return error(
            factors_field,
            format!("has {} entries but `{filters_field}` has {}", factors.len(), filters.len()),
        );
    }
    if factors.contains(&0) {
        return error(factors_field, "must be at least 1 each".into());
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
    fn errors_name_the_field() {
        let broken = CapeConfig { factors: vec![1, 2], ..CapeConfig::paper() };
        assert!(broken.validate().unwrap_err().to_string().contains("factors"));
        let broken = CapeConfig { pose_embedding: 25, ..CapeConfig::paper() };
        assert!(broken.validate().unwrap_err().to_string().contains("group normalisation"));
        let broken = CapeConfig { pose_embedding: 0, outfit_embedding: 0, ..CapeConfig::paper() };
        assert!(broken.validate().unwrap_err().to_string().contains("decoder_conditions"));
    }
}
