//! Named tensors of a state file, as numbers.

use std::collections::BTreeMap;

use safetensors::tensor::{Dtype, SafeTensors};

use super::ImportError;

/// Most values of one tensor: far above 4 x 64 x 64, far below what hurts.
const MOST_VALUES: usize = 1 << 22;

/// One tensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Its name in the file.
    pub name: String,
    /// Its dimensions.
    pub shape: Vec<usize>,
    /// Row-major values.
    pub values: Vec<f64>,
}

/// A state file: its tensors by name, and its metadata.
#[derive(Clone, Debug, Default)]
pub struct State {
    /// By name.
    pub tensors: BTreeMap<String, Tensor>,
    /// Text by name.
    pub metadata: BTreeMap<String, String>,
}

/// A half-precision number from its bits.
#[must_use]
pub fn half(bits: u16) -> f64 {
    let fraction = f64::from(bits & 0x3ff) / 1024.0;
    let magnitude = match (bits >> 10) & 0x1f {
        0 => fraction * 2f64.powi(-14),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        exponent => (1.0 + fraction) * 2f64.powi(i32::from(exponent) - 15),
    };
    if bits & 0x8000 == 0 { magnitude } else { -magnitude }
}

/// Numbers of a safetensors type; none for types that are no floating-point numbers we read.
fn numbers(dtype: Dtype, bytes: &[u8]) -> Option<Vec<f64>> {
    Some(match dtype {
        Dtype::F32 => bytes.as_chunks::<4>().0.iter().map(|word| f64::from(f32::from_le_bytes(*word))).collect(),
        Dtype::F64 => bytes.as_chunks::<8>().0.iter().map(|word| f64::from_le_bytes(*word)).collect(),
        Dtype::F16 => bytes.as_chunks::<2>().0.iter().map(|word| half(u16::from_le_bytes(*word))).collect(),
        Dtype::BF16 => {
            bytes.as_chunks::<2>().0.iter().map(|word| f64::from(f32::from_bits(u32::from(u16::from_le_bytes(*word)) << 16))).collect()
        }
        _ => return None,
    })
}

impl State {
    /// Reads the bytes of a safetensors file.
    ///
    /// # Errors
    /// When the file is damaged, or holds a tensor that is not of finite floating-point numbers.
    pub fn from_safetensors(bytes: &[u8]) -> Result<Self, ImportError> {
        let damaged = |error: safetensors::SafeTensorError| ImportError::Format {
            message: format!("not a readable safetensors file ({error}); was it cut off? Save the network again"),
        };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
        let metadata = header.metadata().iter().flatten().map(|(key, value)| (key.clone(), value.clone())).collect();
        let file = SafeTensors::deserialize(bytes).map_err(damaged)?;
        let mut tensors = BTreeMap::new();
        for (name, view) in file.iter() {
            let values = numbers(view.dtype(), view.data()).ok_or_else(|| {
                ImportError::tensor(name, format!("its values are {:?}, floating-point numbers are wanted; save `.float()`", view.dtype()))
            })?;
            let tensor = Tensor::new(name, view.shape().to_vec(), values)?;
            tensors.insert(name.to_owned(), tensor);
        }
        Ok(Self { tensors, metadata })
    }

    /// A tensor by name.
    pub fn get(&self, name: &str) -> Result<&Tensor, ImportError> {
        self.tensors.get(name).ok_or_else(|| ImportError::tensor(name, "is missing; save the whole state of the network"))
    }
}

impl Tensor {
    /// A tensor of finite values that fill its shape.
    ///
    /// # Errors
    /// When they do not fill it or one is not finite.
    pub fn new(name: &str, shape: Vec<usize>, values: Vec<f64>) -> Result<Self, ImportError> {
        let count = shape.iter().try_fold(1usize, |product, side| product.checked_mul(*side)).filter(|count| *count <= MOST_VALUES);
        let Some(count) = count else {
            return Err(ImportError::tensor(name, format!("the shape {shape:?} is too large; layers have at most 64 units")));
        };
        if count != values.len() {
            let problem =
                format!("the shape {shape:?} wants {count} values, there are {}; was the file cut off? Save it again", values.len());
            return Err(ImportError::tensor(name, problem));
        }
        if let Some(index) = values.iter().position(|value| !value.is_finite()) {
            return Err(ImportError::tensor(name, format!("value {index} is not finite; did the training diverge?")));
        }
        Ok(Self { name: name.to_owned(), shape, values })
    }

    /// Rows and columns of a matrix.
    ///
    /// # Errors
    /// When it is none.
    pub fn matrix(&self) -> Result<(usize, usize), ImportError> {
        match self.shape[..] {
            [rows, columns] if rows > 0 && columns > 0 => Ok((rows, columns)),
            _ => Err(ImportError::tensor(&self.name, format!("the shape {:?} is that of no matrix with rows and columns", self.shape))),
        }
    }

    /// The values of a tensor of this shape.
    ///
    /// # Errors
    /// When its shape is another.
    pub fn shaped(&self, shape: &[usize]) -> Result<&[f64], ImportError> {
        if self.shape == shape {
            Ok(&self.values)
        } else {
            Err(ImportError::tensor(&self.name, format!("the shape is {:?}, {shape:?} belongs to the rest of the network", self.shape)))
        }
    }
}

/// The transpose of a row-major matrix.
#[must_use]
pub fn transposed(values: &[f64], rows: usize, columns: usize) -> Vec<f64> {
    (0..columns).flat_map(|column| (0..rows).map(move |row| values[row * columns + column])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_precision_bits_have_their_values() {
        let pairs =
            [(0x3c00, 1.0), (0xc000, -2.0), (0x3555, 0.333_251_953_125), (0x0001, 2f64.powi(-24)), (0x7bff, 65504.0), (0x8000, 0.0)];
        for (bits, value) in pairs {
            assert_eq!(half(bits), value, "{bits:#06x}");
        }
        assert!(half(0x7c00).is_infinite() && half(0x7e00).is_nan());
    }

    #[test]
    fn a_transpose_exchanges_rows_and_columns() {
        assert_eq!(transposed(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 2, 3), [1.0, 4.0, 2.0, 5.0, 3.0, 6.0]);
    }
}
