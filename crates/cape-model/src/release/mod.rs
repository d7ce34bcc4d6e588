//! Weights under the names of the authors' TensorFlow release.
//!
//! | ours | theirs |
//! |---|---|
//! | `generator.condition.pose.{hidden,output}` | `condition_pose/fc{1,2}/dense` |
//! | `generator.condition.outfit.{hidden,output}` | `condition_clo_label/fc{1,2}/dense` |
//! | `generator.encoder.blocks.i` | `generator/encoder/<name>i+1` |
//! | `generator.encoder.reduce` | `generator/encoder/1x1-conv` |
//! | `generator.encoder.{mean,log_variance}` | `generator/encoder/fc_{mean,var}/dense` |
//! | `generator.decoder.input` | `generator/decoder/fc1/dense` |
//! | `generator.decoder.expand` | `generator/decoder/1x1-conv` |
//! | `generator.decoder.blocks.i` | `generator/decoder/<name>i+1` |
//! | `generator.decoder.output`, `.output_bias` | `generator/decoder/outputs/{weights,bias}` |
//! | `discriminator.layers.i` | `discriminator/shared/conv i+1` |
//! | `discriminator.output` | `discriminator/prediction_map` |
//!
//! The scopes of blocks have different names in the release's architectures (`encoder_conv`,
//! `decoder_resblock_cmr`, `decoder_resblock_affine`, …) and are identified by their number. The
//! variables inside are identified by name, and two convolutions of one scope by shape, then by
//! order. Shapes are equal except for leading ones of biases.

mod checkpoint;
mod infer;
mod names;

use std::collections::BTreeMap;

pub use checkpoint::ReleaseCheckpoint;
pub use infer::{check_vertices, infer};
pub use names::export;

use crate::{
    CapeConfig, DecoderBlock, Error, Result,
    weights::{HostArray, Weights},
};

/// Names of this crate's parameters with the names of the release's variables.
///
/// ```
/// use burn::tensor::Device;
/// use cape_graph::{DevicePyramid, SparseMatrix, sparse_from_triplets};
/// use cape_model::{
///     Cape, CapeConfig, Graphs,
///     release::{export, import, infer, name_map},
///     weights::collect,
/// };
///
/// let triangle = sparse_from_triplets(
///     "L", (3, 3), &[0, 0, 1, 1, 2, 2], &[1, 2, 0, 2, 0, 1], &[-0.5; 6])?;
/// let device = Device::default();
/// let graphs = Graphs {
///     edges: SparseMatrix::new(&triangle, &device),
///     generator: DevicePyramid::new(&vec![triangle; 3], &[None, None], &[None, None], &device),
///     discriminator: None,
/// };
/// let config = CapeConfig {
///     filters: vec![4, 8],
///     factors: vec![1, 1],
///     discriminator: None,
///     ..CapeConfig::tiny()
/// };
/// let weights = collect(&Cape::new(&config, &graphs, 1, &device)?);
/// let theirs = export(&config, &weights)?;
/// assert_eq!(import(&config, &theirs)?, weights);
///
/// let shapes: Vec<_> = theirs.iter().map(|(name, it)| (name.clone(), it.shape.clone())).collect();
/// let names = name_map(&config, &shapes)?;
/// assert_eq!(names["generator.encoder.mean.bias"], "generator/encoder/fc_mean/dense/bias:0");
/// // The architecture follows from the shapes.
/// assert_eq!(infer(&shapes)?.filters, config.filters);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type NameMap = BTreeMap<String, String>;

/// Maps the parameter names of a model of `config` to names of the release's variables.
///
/// `shapes` lists names and shapes of the variables in the order of their creation; names may end
/// in `:0`.
///
/// # Errors
/// If a variable of the configuration is missing, or a variable is unknown; it is named.
pub fn name_map(config: &CapeConfig, shapes: &[(String, Vec<usize>)]) -> Result<NameMap> {
    let mut map = NameMatcher { shapes, taken: vec![false; shapes.len()], names: NameMap::new() };

    for (ours, theirs, size, layers) in [
        ("pose", "condition_pose", config.pose_embedding, config.pose_layers),
        ("outfit", "condition_clo_label", config.outfit_embedding, config.outfit_layers),
    ] {
        if size == 0 {
            continue;
        }
        if layers == 2 {
            map.dense(&format!("generator.condition.{ours}.hidden"), &format!("{theirs}/fc1"))?;
        }
        map.dense(&format!("generator.condition.{ours}.output"), &format!("{theirs}/fc{layers}"))?;
    }

    let encoder = "generator/encoder";
    let mut input = 3 + if config.encoder_conditions { config.condition_size() } else { 0 };
    for (i, &output) in config.filters.iter().enumerate() {
        let ours = format!("generator.encoder.blocks.{i}");
        let scope = map.block_scope(encoder, i + 1)?;
        if config.encoder_residual {
            map.encoder_residual(&ours, &scope, config.order, input, output)?;
        } else {
            map.conv_layer(&ours, &scope)?;
        }
        input = output;
    }
    map.dense("generator.encoder.mean", &format!("{encoder}/fc_mean"))?;
    map.dense("generator.encoder.log_variance", &format!("{encoder}/fc_var"))?;
    if config.reduce > 0 {
        map.take("generator.encoder.reduce.weight", &format!("{encoder}/1x1-conv/weights"))?;
    }

    let decoder = "generator/decoder";
    map.dense("generator.decoder.input", &format!("{decoder}/fc1"))?;
    if config.reduce > 0 {
        map.take("generator.decoder.expand.weight", &format!("{decoder}/1x1-conv/weights"))?;
    }
    for i in 0..config.filters.len() {
        let ours = format!("generator.decoder.blocks.{i}");
        let scope = map.block_scope(decoder, i + 1)?;
        match config.decoder {
            DecoderBlock::Residual => map.residual(&ours, &scope)?,
            DecoderBlock::Affine => {
                map.take(&format!("{ours}.conv.weight"), &format!("{scope}/graph_conv/weights"))?;
                map.take(&format!("{ours}.linear.weight"), &format!("{scope}/affine/weights"))?;
            }
            DecoderBlock::Plain => map.conv_layer(&ours, &scope)?,
        }
    }
    map.take("generator.decoder.output.weight", &format!("{decoder}/outputs/weights"))?;
    map.take("generator.decoder.output_bias", &format!("{decoder}/outputs/bias"))?;

    if let Some(discriminator) = &config.discriminator {
        for i in 0..discriminator.filters.len() {
            let scope = format!("discriminator/shared/conv{}", i + 1);
            map.conv_layer(&format!("discriminator.layers.{i}"), &scope)?;
        }
        map.take("discriminator.output.weight", "discriminator/prediction_map/weights")?;
    }
    map.finish()
}

/// Weights of a model of `config` from the release's variables.
///
/// # Errors
/// As [`name_map`]. Shapes are checked by [`apply`](crate::weights::apply).
pub fn import(config: &CapeConfig, variables: &[(String, HostArray)]) -> Result<Weights> {
    let shapes: Vec<_> =
        variables.iter().map(|(name, array)| (name.clone(), array.shape.clone())).collect();
    let by_name: BTreeMap<&str, &HostArray> =
        variables.iter().map(|(name, array)| (name.as_str(), array)).collect();
    let map = name_map(config, &shapes)?;
    Ok(map
        .into_iter()
        .map(|(ours, theirs)| (ours, without_leading_ones(by_name[theirs.as_str()], &theirs)))
        .collect())
}

/// The array without leading axes of length 1 of biases `[1, 1, channels]` and `[1, vertices, 3]`.
fn without_leading_ones(array: &HostArray, name: &str) -> HostArray {
    let mut shape = array.shape.as_slice();
    if bare(name).ends_with("/bias") {
        while shape.len() > 1 && shape[0] == 1 {
            shape = &shape[1..];
        }
    }
    HostArray { shape: shape.to_vec(), values: array.values.clone() }
}

fn bare(name: &str) -> &str {
    name.strip_suffix(":0").unwrap_or(name)
}

struct NameMatcher<'a> {
    shapes: &'a [(String, Vec<usize>)],
    taken: Vec<bool>,
    names: NameMap,
}

impl NameMatcher<'_> {
    fn claim(&mut self, ours: &str, index: usize) {
        self.taken[index] = true;
        self.names.insert(ours.to_owned(), self.shapes[index].0.clone());
    }

    fn take(&mut self, ours: &str, theirs: &str) -> Result<()> {
        match self.shapes.iter().position(|(name, _)| bare(name) == theirs) {
            Some(index) => {
                self.claim(ours, index);
                Ok(())
            }
            None => Err(missing(theirs)),
        }
    }

    fn dense(&mut self, ours: &str, scope: &str) -> Result<()> {
        self.take(&format!("{ours}.weight"), &format!("{scope}/dense/kernel"))?;
        self.take(&format!("{ours}.bias"), &format!("{scope}/dense/bias"))
    }

    fn conv_layer(&mut self, ours: &str, scope: &str) -> Result<()> {
        self.take(&format!("{ours}.conv.weight"), &format!("{scope}/weights"))?;
        self.take(&format!("{ours}.bias"), &format!("{scope}/bias"))
    }

    fn residual(&mut self, ours: &str, scope: &str) -> Result<()> {
        for (part, norm) in
            [("norm_1", "group_norm"), ("norm_2", "group_norm_1"), ("norm_3", "group_norm_2")]
        {
            self.take(&format!("{ours}.{part}.gamma"), &format!("{scope}/{norm}/gamma"))?;
            self.take(&format!("{ours}.{part}.beta"), &format!("{scope}/{norm}/beta"))?;
        }
        for (part, conv) in
            [("linear_1", "graph_linear_1"), ("conv", "graph_conv"), ("linear_2", "graph_linear_2")]
        {
            self.take(&format!("{ours}.{part}.weight"), &format!("{scope}/{conv}/weights"))?;
        }
        let skip = format!("{scope}/graph_linear_input/weights");
        if self.shapes.iter().any(|(name, _)| bare(name) == skip) {
            self.take(&format!("{ours}.skip.weight"), &skip)?;
        }
        Ok(())
    }

    /// Matches two convolutions, two biases and, if the widths differ, a linear map.
    fn encoder_residual(
        &mut self,
        ours: &str,
        scope: &str,
        order: usize,
        input: usize,
        output: usize,
    ) -> Result<()> {
        let wide = |shape: &[usize]| shape.last() == Some(&output);
        self.take_shaped(ours, "layer.bias", &self.inside(scope, "bias"), wide)?;
        self.take_shaped(ours, "bias", &self.inside(scope, "bias"), wide)?;
        if input != output {
            // The second convolution can have the same shape; the linear map was created after it.
            let mut weights = self.inside(scope, "weights");
            weights.reverse();
            weights.sort_by_key(|&index| !is_skip(&self.shapes[index].0[scope.len()..]));
            self.take_shaped(ours, "skip.weight", &weights, |shape| shape == [input, output])?;
        }
        let weights = self.inside(scope, "weights");
        self.take_shaped(ours, "layer.conv.weight", &weights, |s| s == [input * order, output])?;
        self.take_shaped(ours, "conv.weight", &weights, |s| s == [output * order, output])
    }

    /// Indices of the variables of `scope` whose last name starts with `kind`.
    fn inside(&self, scope: &str, kind: &str) -> Vec<usize> {
        let is_kind = |name: &str| {
            let inside = bare(name).strip_prefix(scope).and_then(|rest| rest.strip_prefix('/'));
            inside.is_some_and(|rest| rest.rsplit('/').next().is_some_and(|l| l.starts_with(kind)))
        };
        (0..self.shapes.len()).filter(|&index| is_kind(&self.shapes[index].0)).collect()
    }

    /// Claims the first free variable of `indices` whose shape `fits`.
    fn take_shaped(
        &mut self,
        ours: &str,
        part: &str,
        indices: &[usize],
        fits: impl Fn(&[usize]) -> bool,
    ) -> Result<()> {
        let found = indices.iter().find(|&&i| !self.taken[i] && fits(&self.shapes[i].1));
        let index = *found.ok_or_else(|| missing(&format!("{ours}.{part}")))?;
        self.claim(&format!("{ours}.{part}"), index);
        Ok(())
    }

    fn block_scope(&self, parent: &str, number: usize) -> Result<String> {
        block_scope(self.shapes.iter().map(|(name, _)| name.as_str()), parent, number)
            .ok_or_else(|| missing(&format!("{parent}/…{number}")))
    }

    fn finish(self) -> Result<NameMap> {
        match self.taken.iter().position(|taken| !taken) {
            None => Ok(self.names),
            Some(index) => Err(Error::Weight {
                name: self.shapes[index].0.clone(),
                message: "no such variable in a model of this configuration".into(),
            }),
        }
    }
}

/// Scope of block `number` of the scope `parent`: its name ends in that number and is not the name
/// of a fixed layer.
fn block_scope<'a>(
    mut names: impl Iterator<Item = &'a str>,
    parent: &str,
    number: usize,
) -> Option<String> {
    const FIXED: [&str; 5] = ["fc_mean", "fc_var", "fc1", "1x1-conv", "outputs"];
    names.find_map(|name| {
        let scope = name.strip_prefix(parent)?.strip_prefix('/')?.split('/').next()?;
        let stem = scope.trim_end_matches(|c: char| c.is_ascii_digit());
        let found = !FIXED.contains(&scope) && scope[stem.len()..].parse() == Ok(number);
        found.then(|| format!("{parent}/{scope}"))
    })
}

/// True if the name of a variable indicates the skip path of a block.
fn is_skip(name: &str) -> bool {
    ["input", "skip", "short", "linear", "1x1"].iter().any(|hint| name.contains(hint))
}

fn missing(name: &str) -> Error {
    Error::Weight { name: name.to_owned(), message: "missing".into() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DecoderConditions;

    fn variables(names: &[(&str, &[usize])]) -> Vec<(String, Vec<usize>)> {
        names.iter().map(|(name, shape)| ((*name).to_owned(), shape.to_vec())).collect()
    }

    /// One residual encoder block from 3 to 4 channels and a plain decoder, without conditions.
    fn config() -> CapeConfig {
        CapeConfig {
            filters: vec![4],
            factors: vec![1],
            order: 2,
            latent: 2,
            reduce: 0,
            pose_embedding: 0,
            outfit_embedding: 0,
            encoder_residual: true,
            decoder: DecoderBlock::Plain,
            decoder_conditions: DecoderConditions::None,
            discriminator: None,
            ..CapeConfig::paper()
        }
    }

    const FIXED: [(&str, &[usize]); 10] = [
        ("generator/decoder/fc1/dense/kernel:0", &[2, 40]),
        ("generator/decoder/fc1/dense/bias:0", &[40]),
        ("generator/decoder/upconv1/weights:0", &[8, 4]),
        ("generator/decoder/upconv1/bias:0", &[1, 1, 4]),
        ("generator/decoder/outputs/weights:0", &[8, 3]),
        ("generator/decoder/outputs/bias:0", &[1, 10, 3]),
        ("generator/encoder/fc_mean/dense/kernel:0", &[40, 2]),
        ("generator/encoder/fc_mean/dense/bias:0", &[2]),
        ("generator/encoder/fc_var/dense/kernel:0", &[40, 2]),
        ("generator/encoder/fc_var/dense/bias:0", &[2]),
    ];

    #[test]
    fn residual_encoder_blocks_are_told_apart_by_shape() {
        let mut names = variables(&FIXED);
        names.extend(variables(&[
            ("generator/encoder/block1/a/weights:0", &[6, 4]),
            ("generator/encoder/block1/a/bias:0", &[1, 1, 4]),
            ("generator/encoder/block1/b/weights:0", &[8, 4]),
            ("generator/encoder/block1/c/weights:0", &[3, 4]),
            ("generator/encoder/block1/d/bias:0", &[1, 1, 4]),
        ]));
        let map = name_map(&config(), &names).unwrap();
        let of = |part: &str| map[&format!("generator.encoder.blocks.0.{part}")].as_str();
        assert_eq!(of("layer.conv.weight"), "generator/encoder/block1/a/weights:0");
        assert_eq!(of("conv.weight"), "generator/encoder/block1/b/weights:0");
        assert_eq!(of("skip.weight"), "generator/encoder/block1/c/weights:0");
        assert_eq!(of("bias"), "generator/encoder/block1/d/bias:0");
        assert_eq!(map["generator.decoder.blocks.0.bias"], "generator/decoder/upconv1/bias:0");
    }

    #[test]
    fn missing_and_extra_variables_are_named() {
        let config = CapeConfig { encoder_residual: false, ..config() };
        let layer = [
            ("generator/encoder/encoder_conv1/weights:0", &[6usize, 4] as &[usize]),
            ("generator/encoder/encoder_conv1/bias:0", &[1, 1, 4]),
        ];
        let mut names = variables(&FIXED);
        let error = name_map(&config, &names).unwrap_err().to_string();
        assert!(error.contains("generator/encoder/"), "{error}");
        names.extend(variables(&layer));
        name_map(&config, &names).unwrap();
        names.push(("generator/extra:0".into(), vec![1]));
        let error = name_map(&config, &names).unwrap_err().to_string();
        assert!(error.contains("generator/extra:0"), "{error}");
    }
}
