use burn::{
    module::Module,
    tensor::{Tensor, activation::leaky_relu},
};

use crate::{
    CapeConfig, Initialiser,
    config::{LEAKY_SLOPE, POSE_FEATURE},
    layers::Linear,
};

/// The embedding net of one condition: one linear layer, or two with a leaky ReLU between.
#[derive(Module, Debug)]
pub struct ConditionNet {
    /// Hidden layer of a two-layer net, `[input, hidden]`.
    pub hidden: Option<Linear>,
    /// Last layer, to the embedding.
    pub output: Linear,
}

impl ConditionNet {
    fn new(input: usize, output: usize, layers: usize, init: &mut Initialiser) -> Self {
        if layers < 2 {
            return Self { hidden: None, output: init.linear(input, output) };
        }
        let width = hidden_width(input, output);
        let hidden = init.linear(input, width);
        Self { hidden: Some(hidden), output: init.linear(width, output) }
    }

    fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        let x = match &self.hidden {
            Some(hidden) => leaky_relu(hidden.forward(x), LEAKY_SLOPE),
            None => x,
        };
        self.output.forward(x)
    }
}

/// Width of the hidden layer between `input` and `output` numbers.
pub(crate) fn hidden_width(input: usize, output: usize) -> usize {
    if output < input / 2 {
        input / 2
    } else if output < 2 * input {
        input
    } else {
        output / 2
    }
}

/// Embeddings of pose and outfit (CAPE §4.1 and appendix A.1), shared by the decoder and the
/// discriminator.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_model::{CapeConfig, ConditionNets, Initialiser};
///
/// let config = CapeConfig::paper();
/// let device = Device::default();
/// let nets = ConditionNets::new(&config, &mut Initialiser::new(1, config.deviation, &device));
/// let (pose, outfit) = (Tensor::zeros([3, 126], &device), Tensor::zeros([3, 4], &device));
/// let embedding = nets.forward(pose, outfit).unwrap();
/// assert_eq!(embedding.dims(), [3, 24 + 8]);
/// // The pose has a hidden layer, the outfit none.
/// assert!(nets.pose.is_some_and(|net| net.hidden.is_some()));
/// assert!(nets.outfit.is_some_and(|net| net.hidden.is_none()));
/// ```
#[derive(Module, Debug)]
pub struct ConditionNets {
    /// Net of the pose feature, `[batch, 126]` → `[batch, pose_embedding]`.
    pub pose: Option<ConditionNet>,
    /// Net of the outfit label, `[batch, outfits]` → `[batch, outfit_embedding]`.
    pub outfit: Option<ConditionNet>,
}

impl ConditionNets {
    /// Creates the nets of `config`; an embedding size of 0 omits the net.
    pub fn new(config: &CapeConfig, init: &mut Initialiser) -> Self {
        let mut net = |input, output, layers| {
            (output > 0).then(|| ConditionNet::new(input, output, layers, init))
        };
        Self {
            pose: net(POSE_FEATURE, config.pose_embedding, config.pose_layers),
            outfit: net(config.outfits.len(), config.outfit_embedding, config.outfit_layers),
        }
    }

    /// `pose_feature: [batch, 126]`, `outfit: [batch, outfits]` → `[batch, embedding]`, pose first;
    /// `None` for an unconditional model.
    pub fn forward(&self, pose_feature: Tensor<2>, outfit: Tensor<2>) -> Option<Tensor<2>> {
        let pose = self.pose.as_ref().map(|net| net.forward(pose_feature));
        let outfit = self.outfit.as_ref().map(|net| net.forward(outfit));
        match (pose, outfit) {
            (Some(pose), Some(outfit)) => Some(Tensor::cat(vec![pose, outfit], 1)),
            (pose, outfit) => pose.or(outfit),
        }
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn hidden_widths_follow_the_rule() {
        assert_eq!(super::hidden_width(126, 24), 63);
        assert_eq!(super::hidden_width(126, 100), 126);
        assert_eq!(super::hidden_width(4, 5), 4);
        assert_eq!(super::hidden_width(4, 8), 4);
        assert_eq!(super::hidden_width(4, 20), 10);
    }
}
