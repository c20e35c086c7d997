//! The messages of an ONNX file that we read, with the field numbers of `onnx.proto`; other fields are skipped.

use prost::Message;

/// A file.
#[derive(Clone, PartialEq, Message)]
pub struct Model {
    /// Which framework wrote it.
    #[prost(string, optional, tag = "2")]
    pub producer_name: Option<String>,
    /// The graph.
    #[prost(message, optional, tag = "7")]
    pub graph: Option<Graph>,
    /// Text by name.
    #[prost(message, repeated, tag = "14")]
    pub metadata: Vec<Entry>,
}

/// A graph.
#[derive(Clone, PartialEq, Message)]
pub struct Graph {
    /// Operations.
    #[prost(message, repeated, tag = "1")]
    pub nodes: Vec<Node>,
    /// Weights.
    #[prost(message, repeated, tag = "5")]
    pub initializers: Vec<Constant>,
    /// What is fed in; old files list the weights too.
    #[prost(message, repeated, tag = "11")]
    pub inputs: Vec<Named>,
    /// What comes out.
    #[prost(message, repeated, tag = "12")]
    pub outputs: Vec<Named>,
}

/// An operation.
#[derive(Clone, PartialEq, Message)]
pub struct Node {
    /// Names of values; an empty one is an input left out.
    #[prost(string, repeated, tag = "1")]
    pub inputs: Vec<String>,
    /// Names of values.
    #[prost(string, repeated, tag = "2")]
    pub outputs: Vec<String>,
    /// Its name.
    #[prost(string, optional, tag = "3")]
    pub name: Option<String>,
    /// What it does.
    #[prost(string, optional, tag = "4")]
    pub operator: Option<String>,
    /// Settings.
    #[prost(message, repeated, tag = "5")]
    pub attributes: Vec<Attribute>,
    /// Empty for the operators of ONNX itself.
    #[prost(string, optional, tag = "7")]
    pub domain: Option<String>,
}

/// A setting.
#[derive(Clone, PartialEq, Message)]
pub struct Attribute {
    /// Its name.
    #[prost(string, optional, tag = "1")]
    pub name: Option<String>,
    /// A number.
    #[prost(float, optional, tag = "2")]
    pub float: Option<f32>,
    /// A whole number.
    #[prost(int64, optional, tag = "3")]
    pub integer: Option<i64>,
    /// Text.
    #[prost(bytes = "vec", optional, tag = "4")]
    pub text: Option<Vec<u8>>,
    /// A tensor.
    #[prost(message, optional, tag = "5")]
    pub tensor: Option<Constant>,
    /// Numbers.
    #[prost(float, repeated, packed = "false", tag = "7")]
    pub floats: Vec<f32>,
    /// Whole numbers.
    #[prost(int64, repeated, packed = "false", tag = "8")]
    pub integers: Vec<i64>,
    /// Texts.
    #[prost(bytes = "vec", repeated, tag = "9")]
    pub texts: Vec<Vec<u8>>,
}

/// A tensor.
#[derive(Clone, PartialEq, Message)]
pub struct Constant {
    /// Dimensions.
    #[prost(int64, repeated, packed = "false", tag = "1")]
    pub dimensions: Vec<i64>,
    /// See [`super::graph`].
    #[prost(int32, optional, tag = "2")]
    pub data_type: Option<i32>,
    /// Values of type float.
    #[prost(float, repeated, tag = "4")]
    pub floats: Vec<f32>,
    /// Values of type int64.
    #[prost(int64, repeated, tag = "7")]
    pub integers: Vec<i64>,
    /// Its name.
    #[prost(string, optional, tag = "8")]
    pub name: Option<String>,
    /// Values of any type, little-endian.
    #[prost(bytes = "vec", optional, tag = "9")]
    pub raw: Option<Vec<u8>>,
    /// Values of type double.
    #[prost(double, repeated, tag = "10")]
    pub doubles: Vec<f64>,
    /// Where values in another file lie.
    #[prost(message, repeated, tag = "13")]
    pub external: Vec<Entry>,
    /// 1 for values in another file.
    #[prost(int32, optional, tag = "14")]
    pub location: Option<i32>,
}

/// A value with a name.
#[derive(Clone, PartialEq, Message)]
pub struct Named {
    /// Its name.
    #[prost(string, optional, tag = "1")]
    pub name: Option<String>,
}

/// Text with a key.
#[derive(Clone, PartialEq, Message)]
pub struct Entry {
    /// The key.
    #[prost(string, optional, tag = "1")]
    pub key: Option<String>,
    /// The text.
    #[prost(string, optional, tag = "2")]
    pub value: Option<String>,
}
