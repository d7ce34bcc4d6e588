//! Decoder and encoder of a clothed model as graphs.

use cape_core::{joints::CLOTHING_JOINTS, tensors::to_host};
use cape_graph::{MeshPyramid, Transition};
use cape_infer::ClothedModel;
use cape_model::{
    DecoderConditions, DecoderLayer, EncoderBlock,
    layers::{AffineBlock, ConvLayer, EncoderResidual, ResidualBlock},
};

use crate::{
    OnnxModel, Result, WeightPrecision,
    graph::{GraphBuilder, Value, single},
    layers::{
        HostConv, append, bias_leaky_relu, chebyshev_sum, convolve, embedding, group_norm_relu,
        leaky_relu, linear, products, relu,
    },
    metadata::describe,
    rotations::{POSE, pose_rotations},
    sparse::{LevelGraph, sparse_product},
};

/// Decoder of a model: `code` `[batch, latent]`, `pose` `[batch, 72]` in axis-angle and `outfit`
/// `[batch, outfits]` one-hot, to `displacement` `[batch, V, 3]` in metres, at all vertices. Conditions
/// that the model does not have are not among the inputs.
///
/// ```
/// use cape_onnx::WeightPrecision;
///
/// let model = cape_weights::pretrained(&burn::tensor::Device::default())?;
/// let decoder = cape_onnx::export_decoder(&model, WeightPrecision::Half)?;
/// let inputs: Vec<_> = decoder.inputs().into_iter().map(|input| input.name).collect();
/// assert_eq!(inputs, ["code", "pose", "outfit"]);
/// assert_eq!(decoder.outputs()[0].shape, [None, Some(6890), Some(3)]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// If a weight is too large for half precision.
pub fn export_decoder(model: &ClothedModel, precision: WeightPrecision) -> Result<OnnxModel> {
    let mut graph = GraphBuilder::new("decoder", precision);
    let config = &model.config().model;
    let code = graph.input("code", &[config.latent]);
    let conditioned = config.decoder_conditions != DecoderConditions::None;
    let condition = if conditioned { embed_conditions(&mut graph, model)? } else { None };
    let displacement = decode(&mut graph, model, &code, condition.as_ref())?;
    graph.output("displacement", &displacement, &[model.body().vertices(), 3]);
    let text = "Displacements of clothing of latent codes, poses and outfits (CAPE)";
    Ok(describe(graph.finish(text), model, precision))
}

/// Encoder of a model: `displacement` `[batch, V, 3]` in metres, and `pose` and `outfit` if the model was
/// trained with conditions of the encoder, to the posterior's `mean` and `log_variance`,
/// `[batch, latent]` each.
///
/// ```
/// use cape_onnx::WeightPrecision;
///
/// let model = cape_weights::pretrained(&burn::tensor::Device::default())?;
/// let encoder = cape_onnx::export_encoder(&model, WeightPrecision::Half)?;
/// let outputs: Vec<_> = encoder.outputs().into_iter().map(|output| output.name).collect();
/// assert_eq!(outputs, ["mean", "log_variance"]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// If a weight is too large for half precision.
pub fn export_encoder(model: &ClothedModel, precision: WeightPrecision) -> Result<OnnxModel> {
    let mut graph = GraphBuilder::new("encoder", precision);
    let config = &model.config().model;
    let displacement = graph.input("displacement", &[model.body().vertices(), 3]);
    let conditioned = config.encoder_conditions;
    let condition = if conditioned { embed_conditions(&mut graph, model)? } else { None };
    let [mean, log_variance] = encode(&mut graph, model, &displacement, condition.as_ref())?;
    graph.output("mean", &mean, &[config.latent]);
    graph.output("log_variance", &log_variance, &[config.latent]);
    let text = "Posterior of the latent code of displacements of clothing (CAPE)";
    Ok(describe(graph.finish(text), model, precision))
}

/// The inputs `pose` and `outfit` as far as the model has nets for them, embedded, `[batch, size]`.
fn embed_conditions(graph: &mut GraphBuilder, model: &ClothedModel) -> Result<Option<Value>> {
    let nets = &model.generator().condition;
    let mut embedded = Vec::new();
    if let Some(net) = &nets.pose {
        let pose = graph.input(POSE, &[3 * model.body().joints()]);
        let rotations = pose_rotations(graph, &pose, &CLOTHING_JOINTS);
        let feature = graph.reshape(&rotations, &[9 * CLOTHING_JOINTS.len()]);
        embedded.push(embedding(graph, net, &feature)?);
    }
    if let Some(net) = &nets.outfit {
        let outfit = graph.input("outfit", &[model.outfits().len()]);
        embedded.push(embedding(graph, net, &outfit)?);
    }
    Ok((!embedded.is_empty()).then(|| graph.concat(&embedded, 1)))
}

/// Displacements in metres of codes.
fn decode(
    graph: &mut GraphBuilder,
    model: &ClothedModel,
    code: &Value,
    condition: Option<&Value>,
) -> Result<Value> {
    let (config, decoder) = (&model.config().model, &model.generator().decoder);
    let levels = PyramidGraphs::new(model.pyramid());
    let code = match condition {
        Some(condition) => graph.concat(&[code.clone(), condition.clone()], 1),
        None => code.clone(),
    };
    let everywhere = config.decoder_conditions == DecoderConditions::Everywhere;
    let condition =
        condition.filter(|_| everywhere).map(|condition| (condition, config.condition_size()));
    let coarsest = decoder.blocks.len();
    let coarse = levels.vertices(coarsest);
    let features = linear(graph, &decoder.input, &code)?;
    let features = leaky_relu(graph, &features);
    let [_, flat] = decoder.input.weight.val().dims();
    let mut x = graph.reshape(&features, &[coarse, flat / coarse]);
    if let Some(expand) = &decoder.expand {
        x = convolve(graph, &HostConv::new(expand), &x, &levels.graphs[coarsest], None)?;
    }
    for (block, level) in decoder.blocks.iter().zip((0..coarsest).rev()) {
        x = match block {
            DecoderLayer::Residual(block) => {
                residual_block(graph, block, &x, condition, (&levels, level))?
            }
            DecoderLayer::Affine(block) => {
                affine_block(graph, block, &x, condition, (&levels, level))?
            }
            DecoderLayer::Plain(layer) => {
                let conv = HostConv::new(&layer.conv);
                let up = |graph: &mut GraphBuilder, x: &Value| levels.up(graph, x, level);
                let products = products(graph, &[&conv], &x, condition, up)?;
                let x = chebyshev_sum(graph, &products, &levels.graphs[level]);
                bias_leaky_relu(graph, &x, to_host(layer.bias.val()))?
            }
        };
    }
    let output = HostConv::new(&decoder.output);
    let products = products(graph, &[&output], &x, condition, |_, x| x.clone())?;
    let mut x = chebyshev_sum(graph, &products, &levels.graphs[0]);
    if let Some(path) = &decoder.linear_path {
        let [size, flat] = path.val().dims();
        let weight = graph.weights("linear path", &[size, flat], &to_host(path.val()))?;
        let linear = graph.matmul(&code, &weight);
        let linear = graph.reshape(&linear, &[flat / 3, 3]);
        x = graph.add(&x, &linear);
    }

    // Bias, deviation and mean of each coordinate as one scale and offset.
    let statistics = model.statistics();
    let bias = to_host(decoder.output_bias.val());
    let offsets = statistics.mean().iter().zip(statistics.std()).zip(bias);
    let offsets: Vec<f32> =
        offsets.map(|((mean, std), bias)| (mean + std * f64::from(bias)) as f32).collect();
    let shape = [statistics.vertices(), 3];
    let scale = graph.constants(&shape, &single(statistics.std()));
    let offset = graph.constants(&shape, &offsets);
    let scaled = graph.mul(&x, &scale);
    Ok(graph.add(&scaled, &offset))
}

/// `relu(cheb(x)) + linear(x)` of the up-sampled features.
fn affine_block(
    graph: &mut GraphBuilder,
    block: &AffineBlock,
    x: &Value,
    condition: Option<(&Value, usize)>,
    (levels, level): (&PyramidGraphs, usize),
) -> Result<Value> {
    let convs = [&block.conv, &block.linear].map(HostConv::new);
    let up = |graph: &mut GraphBuilder, x: &Value| levels.up(graph, x, level);
    let mut products = products(graph, &[&convs[0], &convs[1]], x, condition, up)?;
    let linear = products.split_off(convs[0].order);
    let conv = chebyshev_sum(graph, &products, &levels.graphs[level]);
    let conv = relu(graph, &conv);
    Ok(graph.add(&conv, &linear[0]))
}

/// Bottleneck of normalised convolutions, added to the up-sampled input.
fn residual_block(
    graph: &mut GraphBuilder,
    block: &ResidualBlock,
    x: &Value,
    condition: Option<(&Value, usize)>,
    (levels, level): (&PyramidGraphs, usize),
) -> Result<Value> {
    let (coarse, fine) = (&levels.graphs[level + 1], &levels.graphs[level]);
    let x = append(graph, x, condition, levels.vertices(level + 1));
    let base = match &block.skip {
        Some(skip) => convolve(graph, &HostConv::new(skip), &x, coarse, None)?,
        None => x.clone(),
    };
    let base = levels.up(graph, &base, level);
    let mut y = levels.up(graph, &x, level);
    for (norm, conv) in [
        (&block.norm_1, &block.linear_1),
        (&block.norm_2, &block.conv),
        (&block.norm_3, &block.linear_2),
    ] {
        y = group_norm_relu(graph, norm, &y)?;
        y = convolve(graph, &HostConv::new(conv), &y, fine, None)?;
    }
    Ok(graph.add(&y, &base))
}

/// Mean and log-variance of the code of displacements in metres.
fn encode(
    graph: &mut GraphBuilder,
    model: &ClothedModel,
    displacement: &Value,
    condition: Option<&Value>,
) -> Result<[Value; 2]> {
    let (config, encoder) = (&model.config().model, &model.generator().encoder);
    let levels = PyramidGraphs::new(model.pyramid());
    let statistics = model.statistics();
    let shape = [statistics.vertices(), 3];
    let mean = graph.constants(&shape, &single(statistics.mean()));
    let std = graph.constants(&shape, &single(statistics.std()));
    let centred = graph.sub(displacement, &mean);
    let mut x = graph.div(&centred, &std);
    let condition = condition.map(|condition| (condition, config.condition_size()));
    x = append(graph, &x, condition, levels.vertices(0));
    for (level, block) in encoder.blocks.iter().enumerate() {
        x = match block {
            EncoderBlock::Conv(layer) => pooled_layer(graph, layer, &x, (&levels, level))?,
            EncoderBlock::Residual(block) => {
                let x = encoder_residual(graph, block, &x, &levels.graphs[level])?;
                match levels.kept(level) {
                    Some(rows) => graph.select(&x, &rows, 1),
                    None => x,
                }
            }
        };
    }
    let coarsest = encoder.blocks.len();
    if let Some(reduce) = &encoder.reduce {
        x = convolve(graph, &HostConv::new(reduce), &x, &levels.graphs[coarsest], None)?;
    }
    let [flat, _] = encoder.mean.weight.val().dims();
    let flat = graph.reshape(&x, &[flat]);
    Ok([linear(graph, &encoder.mean, &flat)?, linear(graph, &encoder.log_variance, &flat)?])
}

/// Convolution at the vertices that the next level keeps, bias and leaky ReLU.
fn pooled_layer(
    graph: &mut GraphBuilder,
    layer: &ConvLayer,
    x: &Value,
    (levels, level): (&PyramidGraphs, usize),
) -> Result<Value> {
    let conv = HostConv::new(&layer.conv);
    let fine = &levels.graphs[level];
    let x = match levels.kept(level) {
        Some(rows) => {
            let kept = fine.kept_rows(&levels.transitions[level]);
            convolve(graph, &conv, x, fine, Some((&kept, &rows)))?
        }
        None => convolve(graph, &conv, x, fine, None)?,
    };
    bias_leaky_relu(graph, &x, to_host(layer.bias.val()))
}

fn encoder_residual(
    graph: &mut GraphBuilder,
    block: &EncoderResidual,
    x: &Value,
    level: &LevelGraph,
) -> Result<Value> {
    let y = convolve(graph, &HostConv::new(&block.layer.conv), x, level, None)?;
    let y = bias_leaky_relu(graph, &y, to_host(block.layer.bias.val()))?;
    let y = convolve(graph, &HostConv::new(&block.conv), &y, level, None)?;
    let x = match &block.skip {
        Some(skip) => convolve(graph, &HostConv::new(skip), x, level, None)?,
        None => x.clone(),
    };
    let sum = graph.add(&y, &x);
    bias_leaky_relu(graph, &sum, to_host(block.bias.val()))
}

/// The mesh pyramid with the graph of each level.
struct PyramidGraphs<'a> {
    graphs: Vec<LevelGraph>,
    transitions: &'a [Transition],
    pyramid: &'a MeshPyramid,
}

impl<'a> PyramidGraphs<'a> {
    fn new(pyramid: &'a MeshPyramid) -> Self {
        Self {
            graphs: (0..pyramid.levels().len()).map(|i| LevelGraph::new(pyramid, i)).collect(),
            transitions: pyramid.transitions(),
            pyramid,
        }
    }

    fn vertices(&self, level: usize) -> usize {
        self.pyramid.levels()[level].vertex_count()
    }

    /// Interpolation from `level + 1` to `level`.
    fn up(&self, graph: &mut GraphBuilder, x: &Value, level: usize) -> Value {
        let transition = &self.transitions[level];
        if transition.is_identity() { x.clone() } else { sparse_product(graph, transition.up(), x) }
    }

    /// Vertices of `level` that `level + 1` keeps; `None` for all.
    fn kept(&self, level: usize) -> Option<Vec<usize>> {
        let transition = &self.transitions[level];
        let kept = || transition.down().iter().map(|&vertex| vertex as usize).collect();
        (!transition.is_identity()).then(kept)
    }
}
