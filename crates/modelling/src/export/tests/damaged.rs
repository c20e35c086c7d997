//! What happens to damaged blobs.

use super::*;

pub(super) fn small_blob() -> Vec<u8> {
    let mut random = ChaCha8Rng::seed_from_u64(9800);
    let model = hybrid(&mut random, &[5], Activation::Tanh);
    export(&model, &[recording(&mut random, 60)]).unwrap().bytes
}

/// Makes the header fit the bytes, as somebody would who damages a blob on purpose.
pub(super) fn write_crc(bytes: &mut [u8]) {
    let length = u32::try_from(bytes.len()).unwrap();
    bytes[12..16].copy_from_slice(&length.to_le_bytes());
    let crc = crc32(crc32(0, &bytes[..16]), &bytes[20..]);
    bytes[16..20].copy_from_slice(&crc.to_le_bytes());
}

#[test]
fn every_flipped_bit_is_refused_and_named() {
    let mut bytes = small_blob();
    blob::decode(&bytes).unwrap();
    for bit in 0..8 * bytes.len() {
        bytes[bit / 8] ^= 1 << (bit % 8);
        let error = blob::decode(&bytes).unwrap_err();
        let as_expected = match bit / 8 {
            0..8 => error == BlobError::Magic,
            12..16 => matches!(error, BlobError::Truncated { .. } | BlobError::TooLong { .. }),
            _ => matches!(error, BlobError::Checksum { .. }),
        };
        assert!(as_expected, "bit {bit}: {error}");
        bytes[bit / 8] ^= 1 << (bit % 8);
    }
}

#[test]
fn every_truncation_is_refused_and_named() {
    let bytes = small_blob();
    for length in 0..bytes.len() {
        let error = blob::decode(&bytes[..length]).unwrap_err();
        assert!(matches!(error, BlobError::Truncated { .. }), "{length}: {error}");
        assert!(error.to_string().contains("truncated"));
    }
    let longer = [&bytes[..], &[0]].concat();
    assert!(matches!(blob::decode(&longer).unwrap_err(), BlobError::TooLong { .. }));
    // Also with a header that fits: a payload with something behind it, or cut short, with an extension and without.
    let mut bare = blob::decode(&bytes).unwrap().model;
    bare.extension = &[];
    let bare = blob::encode(&bare).unwrap();
    for mut longer in [[&bytes[..], &[0]].concat(), bytes[..bytes.len() - 1].to_vec(), [&bare[..], &[0]].concat()] {
        write_crc(&mut longer);
        assert!(matches!(blob::decode(&longer).unwrap_err(), BlobError::Invalid(invalid) if invalid.field == "extension"));
    }
    let mut shorter = bare[..bare.len() - 1].to_vec();
    write_crc(&mut shorter);
    assert_eq!(blob::decode(&shorter).unwrap_err(), BlobError::Payload);
}

/// Layers of small random weights, times `gain`.
#[test]
fn another_schema_version_and_an_unknown_activation_are_named() {
    let mut bytes = small_blob();
    bytes[8] = 77;
    write_crc(&mut bytes);
    let error = blob::decode(&bytes).unwrap_err();
    assert_eq!(error, BlobError::SchemaVersion { found: 77 });
    assert!(error.to_string().contains("schema version"));

    let bytes = small_blob();
    let mut model = blob::decode(&bytes).unwrap().model;
    model.network.as_mut().unwrap().activation_code = 7;
    assert!(blob::encode(&model).is_err());
    // The encoder refuses, so the number is set in the payload: the byte in front of the layers that makes decoding complain of it.
    let found = (HEADER_BYTES..bytes.len()).find_map(|at| {
        let mut changed = bytes.clone();
        changed[at] = 7;
        write_crc(&mut changed);
        match blob::decode(&changed) {
            Err(error @ BlobError::Activation { found: 7 }) => Some(error),
            _ => None,
        }
    });
    assert!(found.unwrap().to_string().contains("wrong activation"));
}

#[test]
fn the_content_hash_tells_a_forged_payload() {
    let mut bytes = small_blob();
    assert!(blob::content_hash_matches(&bytes));
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    write_crc(&mut bytes);
    assert!(blob::decode(&bytes).is_ok(), "the digest's last byte is free");
    assert!(!blob::content_hash_matches(&bytes));
}

pub(super) fn small_header() -> Vec<u8> {
    let mut header = blob::MAGIC.to_vec();
    header.extend(blob::SCHEMA_VERSION.to_le_bytes());
    header.resize(HEADER_BYTES, 0);
    header
}
