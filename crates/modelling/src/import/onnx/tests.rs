//! Graphs made from `onnx_by_hand.onnx` by one change each.

use prost::Message;

use super::wire::{Attribute, Constant, Model, Named, Node};
use super::{operator, read};
use crate::network::Activation;

fn good() -> Model {
    let bytes = include_bytes!("../../../../../tests/vectors/import/onnx_by_hand.onnx");
    Model::decode(&bytes[..]).expect("a graph")
}

fn node<'a>(model: &'a mut Model, kind: &str) -> &'a mut Node {
    let graph = model.graph.as_mut().expect("a graph");
    graph.nodes.iter_mut().find(|node| operator(node) == kind).expect("such a node")
}

fn setting(name: &str) -> Attribute {
    Attribute { name: Some(name.to_owned()), ..Attribute::default() }
}

fn text(name: &str, text: &str) -> Attribute {
    Attribute { text: Some(text.into()), ..setting(name) }
}

fn texts(name: &str, texts: [&str; 3]) -> Attribute {
    Attribute { texts: texts.map(|text| text.into()).to_vec(), ..setting(name) }
}

fn constant(name: &str, dimensions: &[i64], value: f32) -> Constant {
    let count = dimensions.iter().product::<i64>() as usize;
    let floats = vec![value; count];
    Constant { name: Some(name.into()), dimensions: dimensions.to_vec(), data_type: Some(1), floats, ..Constant::default() }
}

/// The graph with a node between the LSTM's squeezed output and the dense layer.
fn with_between(kind: &str, domain: Option<&str>) -> Model {
    let mut model = good();
    node(&mut model, "MatMul").inputs[0] = "between".to_owned();
    let between = Node {
        inputs: vec!["hidden".into()],
        outputs: vec!["between".into()],
        name: Some("inserted".into()),
        operator: Some(kind.into()),
        domain: domain.map(str::to_owned),
        ..Node::default()
    };
    model.graph.as_mut().expect("a graph").nodes.push(between);
    model
}

/// The graph with something at an optional input of the LSTM, as a constant of this value, or fed in.
fn with_input(index: usize, value: Option<f32>) -> Model {
    let mut model = good();
    let lstm = node(&mut model, "LSTM");
    lstm.inputs.resize(8, String::new());
    lstm.inputs[index] = "given".to_owned();
    let graph = model.graph.as_mut().expect("a graph");
    match value {
        Some(value) => graph.initializers.push(constant("given", &[1, 1, 12], value)),
        None => graph.inputs.push(Named { name: Some("given".into()) }),
    }
    model
}

fn with_setting(attribute: Attribute) -> Model {
    let mut model = good();
    node(&mut model, "LSTM").attributes.push(attribute);
    model
}

fn complaint(model: &Model) -> String {
    read(&model.encode_to_vec()).expect_err("a refusal").to_string()
}

#[test]
fn gates_come_in_our_order() {
    let (network, metadata) = read(&good().encode_to_vec()).expect("a network");
    let layer = &network.layers[0];
    let graph = good().graph.expect("a graph");
    let raw = graph.initializers.iter().find(|constant| constant.name.as_deref() == Some("W")).and_then(|w| w.raw.clone()).expect("W");
    let w: Vec<f64> = raw.as_chunks::<4>().0.iter().map(|word| f64::from(f32::from_le_bytes(*word))).collect();
    // i, o, f, c in the file; i, f, g, o here.
    for (ours, theirs) in [(0, 0), (1, 2), (2, 3), (3, 1)] {
        assert_eq!(layer.input_weights[ours * 12..][..12], w[theirs * 12..][..12]);
    }
    assert_eq!(network.activation, Some(Activation::Tanh));
    assert_eq!(network.last_step_only, Some(false));
    assert_eq!(metadata.get("catheter.input").map(String::as_str), Some("pressure:bar"));
}

#[test]
fn what_an_lstm_node_has_that_our_layer_has_not_is_refused_by_name() {
    let cases = [
        (with_setting(text("direction", "reverse")), "direction reverse"),
        (with_setting(text("direction", "bidirectional")), "direction bidirectional"),
        (with_setting(Attribute { float: Some(3.0), ..setting("clip") }), "clip"),
        (with_setting(Attribute { integer: Some(1), ..setting("input_forget") }), "input_forget"),
        (with_setting(texts("activations", ["HardSigmoid", "Tanh", "Tanh"])), "hardsigmoid"),
        (with_setting(texts("activations", ["Sigmoid", "Relu", "Tanh"])), "relu"),
        (with_input(7, Some(0.1)), "peepholes"),
        (with_input(4, Some(3.0)), "lengths of sequences"),
        (with_input(5, Some(0.5)), "hidden state that is not zero"),
        (with_input(6, Some(0.5)), "cell state that is not zero"),
    ];
    for (model, words) in cases {
        let complaint = complaint(&model);
        assert!(complaint.contains(words) && complaint.contains("`lstm`"), "{words} in: {complaint}");
    }
}

#[test]
fn zero_states_no_peepholes_and_relu_are_understood() {
    for (model, activation) in [
        (with_input(5, Some(0.0)), Activation::Tanh),
        (with_input(7, Some(0.0)), Activation::Tanh),
        (with_setting(texts("activations", ["Sigmoid", "Relu", "Relu"])), Activation::Relu),
    ] {
        assert_eq!(read(&model.encode_to_vec()).expect("a network").0.activation, Some(activation));
    }
    let carried = read(&with_input(5, None).encode_to_vec()).expect("a network").0;
    assert!(carried.notes.iter().any(|note| note.contains("`given`") && note.contains("carried")), "{:?}", carried.notes);
}

#[test]
fn other_operators_are_refused_by_name() {
    for (kind, word) in [
        ("RNN", "a plain recurrent layer"),
        ("Tanh", "behind a recurrent layer"),
        ("Relu", "behind a recurrent layer"),
        ("Clip", "-1 to 1"),
        ("Elu", "activation Elu"),
        ("Mul", "--input-scale"),
        ("LayerNormalization", "operator LayerNormalization"),
        ("Conv", "operator Conv"),
        ("Transpose", "moves the features"),
        ("Reshape", "12 features"),
        ("Gather", "last step"),
    ] {
        let complaint = complaint(&with_between(kind, None));
        assert!(complaint.contains(word) && complaint.contains("`inserted`"), "{kind}: {complaint}");
    }
    assert!(complaint(&with_between("Attention", Some("com.microsoft"))).contains("com.microsoft.Attention"));
    assert!(read(&with_between("Identity", None).encode_to_vec()).is_ok());
}

#[test]
fn a_graph_that_is_none_is_refused() {
    let mut circle = good();
    node(&mut circle, "LSTM").inputs[0] = "hidden".to_owned();
    let mut nowhere = good();
    node(&mut nowhere, "LSTM").inputs[0] = "nothing".to_owned();
    let mut second = good();
    second.graph.as_mut().expect("a graph").outputs.push(Named { name: Some("hidden".into()) });
    let mut beside = second.clone();
    beside.graph.as_mut().expect("a graph").outputs[1].name = Some("x".into());
    let mut cell = good();
    node(&mut cell, "Squeeze").inputs[0] = "cell".to_owned();
    node(&mut cell, "LSTM").outputs = vec!["steps".into(), "last".into(), "cell".into()];
    let mut shortcut = good();
    node(&mut shortcut, "Add").inputs[1] = "hidden".to_owned();
    let mut before = good();
    node(&mut before, "Squeeze").inputs[0] = "x".to_owned();
    node(&mut before, "LSTM").inputs[0] = "y".to_owned();
    before.graph.as_mut().expect("a graph").outputs[0].name = Some("steps".into());
    let cases: [(&Model, &str); 7] = [
        (&circle, "circle"),
        (&nowhere, "`nothing`"),
        (&second, "`hidden`"),
        (&beside, "`x`"),
        (&cell, "cell state"),
        (&shortcut, "addition of two signals"),
        (&before, "without a dense output"),
    ];
    for (model, word) in cases {
        let complaint = complaint(model);
        assert!(complaint.contains(word), "{word} in: {complaint}");
    }
}

#[test]
fn constants_that_do_not_fit_are_refused_by_name() {
    type Change = fn(&mut Constant);
    let cases: [(&str, Change, &str); 7] = [
        ("W", |w| w.dimensions = vec![1, 48, 2], "[1, 48, 2]"),
        ("W", |w| w.dimensions = vec![1, i64::MAX, i64::MAX], "too large"),
        ("W", |w| w.dimensions = vec![1, -48, 1], "negative"),
        ("R", |r| r.dimensions = vec![1, 24, 24], "[1, 24, 24]"),
        ("R", |r| r.data_type = Some(3), "type 3"),
        ("R", |r| r.location = Some(1), "another file"),
        ("B", |b| b.raw = b.raw.as_ref().map(|raw| raw[..8].to_vec()), "2"),
    ];
    for (name, change, word) in cases {
        let mut model = good();
        let constants = &mut model.graph.as_mut().expect("a graph").initializers;
        change(constants.iter_mut().find(|constant| constant.name.as_deref() == Some(name)).expect("such a constant"));
        let complaint = complaint(&model);
        assert!(complaint.contains(word) && complaint.contains(&format!("`{name}`")), "{name}, {word} in: {complaint}");
    }
    let mut sizes = good();
    let hidden_size = sizes.graph.as_mut().and_then(|graph| graph.nodes[0].attributes.first_mut()).expect("hidden_size");
    hidden_size.integer = Some(13);
    assert!(complaint(&sizes).contains("hidden_size says 13"));
}
