//! Number of floating-point operations of a training update.

use crate::{
    CapeConfig, DecoderBlock, DecoderConditions, DiscriminatorConfig, POSE_FEATURE,
    condition::hidden_width,
};

/// Floating-point operations of one update of generator and discriminator on batches of `batch`
/// examples, with two operations per multiply-add. `generator` and `discriminator` are the numbers
/// of vertices of each level of their pyramids. `None` for architectures other than the paper's:
/// residual decoders without a linear path behind plain encoders without conditions.
///
/// Counted are the dense products, forward and backward, of the cheapest equivalent formulation:
/// - convolutions only at the vertices that pooling keeps;
/// - conditions as one vector per example instead of channels at every vertex;
/// - skip paths before up-sampling, on the factored form of their input where that is cheaper;
/// - the last block's outer products merged with the output convolution;
/// - one pass of the discriminator over the generated samples for both its uses.
///
/// The count measures the task; an implementation may execute more. Sparse products (below 1 % for
/// the paper's model), element-wise operations, losses and the optimiser are left out, and
/// up-sampling is assumed to preserve constants.
///
/// # Panics
/// If a pyramid has fewer levels than `config` needs.
pub fn update_flops(
    config: &CapeConfig,
    generator: &[usize],
    discriminator: &[usize],
    batch: usize,
) -> Option<f64> {
    if config.encoder_residual
        || config.encoder_conditions
        || config.linear_path
        || config.decoder != DecoderBlock::Residual
    {
        return None;
    }
    let [first, rest] = encoder(config, generator);
    let adversary =
        config.discriminator.as_ref().map_or(0, |d| discriminator_passes(config, d, discriminator));
    // Forward, input gradient and weight gradient; the data need no gradient.
    let example = 2 * first + 3 * (rest + conditions(config)) + adversary;
    let multiply_adds = batch * example + 3 * decoder(config, generator, batch);
    Some(2.0 * multiply_adds as f64)
}

/// Multiply-adds per example of the encoder's first convolution and of the rest.
fn encoder(config: &CapeConfig, vertices: &[usize]) -> [usize; 2] {
    let mut input = 3;
    let mut layers = Vec::new();
    for (&filters, &kept) in config.filters.iter().zip(&vertices[1..]) {
        layers.push(kept * config.order * input * filters);
        input = filters;
    }
    let coarse = vertices[config.filters.len()];
    let (stem, reduction) = stem(config, coarse);
    let rest = layers[1..].iter().sum::<usize>() + reduction;
    [layers[0], rest + coarse * stem * 2 * config.latent]
}

/// Channels between the coarsest convolutions and the fully connected layers, and the multiply-adds
/// of the 1×1 convolution to them.
fn stem(config: &CapeConfig, coarse: usize) -> (usize, usize) {
    let width = config.filters.last().copied().unwrap_or_default();
    match config.reduce {
        0 => (width, 0),
        reduce => (reduce, coarse * width * reduce),
    }
}

/// Multiply-adds of the condition nets per example.
fn conditions(config: &CapeConfig) -> usize {
    let net = |input: usize, output: usize, layers: usize| match (output, layers) {
        (0, _) => 0,
        (_, 1) => input * output,
        _ => hidden_width(input, output) * (input + output),
    };
    net(POSE_FEATURE, config.pose_embedding, config.pose_layers)
        + net(config.outfits.len(), config.outfit_embedding, config.outfit_layers)
}

/// Multiply-adds of the decoder per batch.
fn decoder(config: &CapeConfig, vertices: &[usize], batch: usize) -> usize {
    let extra = config.block_conditions();
    let levels = config.filters.len();
    let (stem, expansion) = stem(config, vertices[levels]);
    let code_conditions = match config.decoder_conditions {
        DecoderConditions::None => 0,
        _ => config.condition_size(),
    };
    let code = config.latent + code_conditions;
    let mut total = batch * (code * vertices[levels] * stem + expansion);
    // Channels of a block's input, and the inner channels of its factored form.
    let (mut width, mut rank) = (config.filters[levels - 1], stem);
    for (level, &output) in config.filters.iter().enumerate().rev() {
        let (fine, coarse, half) = (vertices[level], vertices[level + 1], output / 2);
        total += batch * fine * (width * half + config.order * half * half);
        total += batch * extra * (half + output);
        if level == 0 {
            total += batch * fine * (half + width) * 3 * config.order;
        } else {
            total += batch * fine * half * output;
            if width + extra != output {
                let direct = batch * coarse * width * output;
                let spanned = batch * coarse * rank * output + rank * width * output;
                if direct <= spanned {
                    rank = width;
                }
                total += direct.min(spanned);
            }
        }
        (width, rank) = (output, rank + half);
    }
    total
}

/// Multiply-adds of all passes of the discriminator per example: forward, input gradient and weight
/// gradient for a generated sample; forward and weight gradient for a real one.
fn discriminator_passes(
    config: &CapeConfig,
    discriminator: &DiscriminatorConfig,
    vertices: &[usize],
) -> usize {
    let (extra, order) = (config.condition_size(), discriminator.order);
    let mut input = 3;
    let mut total = 0;
    for (layer, (&filters, &kept)) in discriminator.filters.iter().zip(&vertices[1..]).enumerate() {
        let product = kept * order * input * filters;
        if layer == 0 {
            // The gradient of the first input is needed for the generator only.
            total += 5 * (product + order * extra * filters);
            // Chebyshev terms of a constant at every vertex.
            total += 4 * kept * order * filters * usize::from(extra > 0);
        } else {
            total += 7 * product;
        }
        input = filters;
    }
    total + 7 * vertices[discriminator.filters.len()] * input * discriminator.output_order
}

#[cfg(test)]
mod tests {
    use super::*;

    const GENERATOR: [usize; 9] = [6890, 6890, 3445, 3445, 1723, 1723, 862, 862, 862];
    const DISCRIMINATOR: [usize; 5] = [6890, 3445, 1723, 862, 431];

    /// An independent count of the paper's model has 19139.2 million operations per example, 158.5
    /// million of them sparse and 3.6 million for up-samplings that do not preserve constants.
    #[test]
    fn the_papers_update_is_counted_exactly() {
        let config = CapeConfig::paper();
        let count = update_flops(&config, &GENERATOR, &DISCRIMINATOR, 16).unwrap();
        let expected = 16e6 * (19139.2 - 158.5 - 3.6);
        assert!((count / expected - 1.0).abs() < 1e-5, "{count:e}, not {expected:e}");
    }

    #[test]
    fn small_decoders_are_counted_by_hand() {
        let config = CapeConfig {
            filters: vec![4, 6],
            factors: vec![1, 2],
            latent: 2,
            reduce: 0,
            pose_embedding: 1,
            outfit_embedding: 1,
            ..CapeConfig::paper()
        };
        let input = (2 + 2) * 5 * 6;
        let coarse = 10 * (6 * 3 + 2 * 3 * 3 + 3 * 6) + 2 * (3 + 6) + 5 * 6 * 6;
        let fine = 10 * (6 * 2 + 2 * 2 * 2 + (2 + 6) * 6) + 2 * (2 + 4);
        assert_eq!(decoder(&config, &[10, 10, 5], 3), 3 * (input + coarse + fine));
    }

    #[test]
    fn other_architectures_are_not_counted() {
        for config in [
            CapeConfig::detail(),
            CapeConfig { encoder_residual: true, ..CapeConfig::paper() },
            CapeConfig { encoder_conditions: true, ..CapeConfig::paper() },
        ] {
            assert_eq!(update_flops(&config, &GENERATOR, &DISCRIMINATOR, 16), None);
        }
        let config = CapeConfig { discriminator: None, ..CapeConfig::narrow() };
        assert!(update_flops(&config, &GENERATOR, &[], 16).is_some_and(|count| count > 1e9));
    }
}
