//! MCAP, which PlotJuggler and Foxglove open: one message for each sample. Written and read are messages in JSON; the numbers of a topic
//! are the columns, nested ones called `outer.inner`. Beside them stands `log_time_s`, the time of the log since the topic's first message.

use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::records::{MessageHeader, Metadata, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{Compression, WriteOptions};
use serde_json::Value;

use crate::arrays::Arrays;
use crate::parts::MOST_VALUES;
use crate::{Note, Subject};

/// Records and chunks, packed or not, are no longer than this: writers make chunks of about 1 MB.
const LONGEST_RECORD: usize = 32 << 20;
/// Topics and fields of a message, at most.
const MOST_NAMES: usize = 1024;
/// Name of our topic.
const TOPIC: &str = "/catheter/recording";

/// The messages of one topic.
#[derive(Default)]
struct Topic {
    names: Vec<String>,
    columns: Vec<Vec<f64>>,
    log_time_s: Vec<f64>,
    /// Time of the first message, ns.
    first: u64,
    /// Messages that lack a number that the first one has.
    incomplete: usize,
}

impl Topic {
    fn take(&mut self, numbers: Vec<(String, f64)>, log_time: u64) {
        if self.log_time_s.is_empty() {
            self.first = log_time;
            self.names = numbers.iter().map(|(name, _)| name.clone()).collect();
            self.columns = vec![Vec::new(); numbers.len()];
        }
        let value = |wanted: &String, place: usize| {
            // The order of fields hardly ever changes.
            let here = numbers.get(place).filter(|(name, _)| name == wanted);
            here.or_else(|| numbers.iter().find(|(name, _)| name == wanted)).map(|(_, value)| *value)
        };
        let values: Option<Vec<f64>> = self.names.iter().enumerate().map(|(place, name)| value(name, place)).collect();
        let Some(values) = values else {
            self.incomplete += 1;
            return;
        };
        self.columns.iter_mut().zip(values).for_each(|(column, value)| column.push(value));
        #[expect(clippy::cast_precision_loss, reason = "2^53 ns are 104 days")]
        self.log_time_s.push((i128::from(log_time) - i128::from(self.first)) as f64 / 1e9);
    }
}

/// Adds the numbers of a message under their names.
fn numbers(value: &Value, name: &str, found: &mut Vec<(String, f64)>) {
    match value {
        Value::Number(number) => found.extend(number.as_f64().map(|value| (name.to_owned(), value))),
        Value::Bool(flag) => found.push((name.to_owned(), f64::from(u8::from(*flag)))),
        Value::Object(fields) => {
            for (field, value) in fields {
                if found.len() < MOST_NAMES {
                    numbers(value, &if name.is_empty() { field.clone() } else { format!("{name}.{field}") }, found);
                }
            }
        }
        _ => {}
    }
}

/// Looks at the chunks first: the reader makes room for as long a name of their compression as they claim to have, and takes it on trust that
/// an uncompressed one ends with a record.
fn check_chunks(bytes: &[u8]) -> Result<(), String> {
    let mut rest = bytes.get(mcap::MAGIC.len()..).unwrap_or_default();
    while let Some((head, body)) = rest.split_at_checked(9) {
        let length = word(&head[1..]);
        let record = usize::try_from(length).ok().and_then(|length| body.get(..length)).unwrap_or(body);
        // Two times, a length and a checksum stand before the name.
        let name = record.get(28..32).map(word);
        if head[0] == op::CHUNK && name.is_none_or(|length| length > 64) {
            return Err("is a damaged MCAP file: a chunk's compression has no name; `mcap recover` may save the rest".to_owned());
        }
        // What an uncompressed chunk holds must end where the chunk does.
        if head[0] == op::CHUNK && name == Some(0) {
            let length = record.get(32..40).map(word).and_then(|length| usize::try_from(length).ok());
            let mut inner = length.and_then(|length| record.get(40..)?.get(..length)).unwrap_or(&[0]);
            while !inner.is_empty() {
                let after = inner.get(1..9).map(word).and_then(|length| usize::try_from(length).ok());
                let after = after.and_then(|length| inner.get(9..)?.get(length..));
                inner = after.ok_or("is a damaged MCAP file: a chunk ends within a record; `mcap recover` may save the rest")?;
            }
        }
        rest = &body[record.len()..];
    }
    Ok(())
}

/// An integer of up to eight bytes.
fn word(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |value, &byte| value << 8 | u64::from(byte))
}

/// Text with its length before it, and what follows.
fn text(bytes: &[u8]) -> Option<(String, &[u8])> {
    let (length, rest) = bytes.split_at_checked(4)?;
    let (text, rest) = rest.split_at_checked(usize::try_from(word(length)).ok()?)?;
    Some((String::from_utf8(text.to_vec()).ok()?, rest))
}

/// What is gathered while reading.
#[derive(Default)]
struct Gathered {
    /// Topic and encoding of each channel.
    channels: BTreeMap<u16, (String, String)>,
    topics: BTreeMap<String, Topic>,
    /// Topics in other encodings.
    others: BTreeMap<String, String>,
    values: usize,
}

impl Gathered {
    /// Takes in a record of a channel: its number, that of its schema, its topic, its encoding.
    fn channel(&mut self, record: &[u8]) -> Option<()> {
        let (numbers, rest) = record.split_at_checked(4)?;
        let (topic, rest) = text(rest)?;
        let (encoding, _) = text(rest)?;
        let number = u16::from_le_bytes([numbers[0], numbers[1]]);
        self.channels.insert(number, (topic, encoding));
        Some(())
    }

    /// Takes in a message: its channel, a sequence number, two times, its data.
    fn message(&mut self, record: &[u8]) -> Result<(), String> {
        let damaged = || "is a damaged MCAP file: a message belongs to no channel; `mcap recover` may save the rest".to_owned();
        let (head, data) = record.split_at_checked(22).ok_or_else(damaged)?;
        let (topic, encoding) = self.channels.get(&u16::from_le_bytes([head[0], head[1]])).ok_or_else(damaged)?;
        if self.topics.len() + self.others.len() >= MOST_NAMES {
            return Err(format!("holds more than {MOST_NAMES} topics"));
        }
        if encoding != "json" {
            self.others.entry(topic.clone()).or_insert_with(|| encoding.clone());
            return Ok(());
        }
        let value: Value = serde_json::from_slice(data)
            .map_err(|error| format!("a message of the topic `{topic}` is no JSON ({error}), though its channel says so"))?;
        let mut found = Vec::new();
        numbers(&value, "", &mut found);
        if found.is_empty() {
            return Ok(());
        }
        self.values += found.len() + 1;
        if self.values > MOST_VALUES {
            return Err("holds more than 50 million numbers; split the recording".to_owned());
        }
        if !self.topics.contains_key(topic) {
            self.topics.insert(topic.clone(), Topic::default());
        }
        if let Some(topic) = self.topics.get_mut(topic) {
            topic.take(found, word(&head[6..14]));
        }
        Ok(())
    }
}

/// Reads the topic that has all wanted columns; of several topics, or of none, the first with numbers.
pub(super) fn read(bytes: &[u8], is_wanted: &dyn Fn(&[String]) -> bool) -> Result<Arrays, String> {
    let damaged = |error: mcap::McapError| format!("is a damaged MCAP file ({error}); `mcap recover` may save the rest");
    check_chunks(bytes)?;
    let options = LinearReaderOptions::default().with_record_length_limit(LONGEST_RECORD).with_validate_chunk_crcs(true);
    let mut reader = LinearReader::new_with_options(options);
    let mut rest = bytes;
    let mut gathered = Gathered::default();
    while let Some(event) = reader.next_event() {
        match event.map_err(damaged)? {
            LinearReadEvent::ReadRequest(wanted) => {
                let (piece, after) = rest.split_at(wanted.min(rest.len()));
                reader.insert(piece.len())[..piece.len()].copy_from_slice(piece);
                reader.notify_read(piece.len());
                rest = after;
            }
            LinearReadEvent::Record { data, opcode: op::CHANNEL } => {
                gathered.channel(data).ok_or("is a damaged MCAP file: a channel ends early; `mcap recover` may save the rest")?;
            }
            LinearReadEvent::Record { data, opcode: op::MESSAGE } => gathered.message(data)?,
            LinearReadEvent::Record { .. } => {}
        }
    }
    let Gathered { mut topics, others, .. } = gathered;
    let with_clock = |topic: &Topic| topic.names.iter().cloned().chain(["log_time_s".to_owned()]).collect::<Vec<_>>();
    let chosen = topics.iter().find(|(_, topic)| is_wanted(&with_clock(topic))).or_else(|| topics.first_key_value());
    let Some(chosen) = chosen.map(|(name, _)| name.clone()) else {
        let encodings: Vec<String> = others.iter().take(5).map(|(topic, encoding)| format!("{topic} ({encoding})")).collect();
        return Err(match encodings.is_empty() {
            true => "holds no messages".to_owned(),
            false => format!("holds no messages in JSON, only {}; export the topic as CSV", encodings.join(", ")),
        });
    };
    let mut notes = Vec::new();
    let passed_over: Vec<&str> = topics.keys().chain(others.keys()).filter(|name| **name != chosen).map(String::as_str).collect();
    if !passed_over.is_empty() {
        let names = passed_over.iter().take(10).copied().collect::<Vec<_>>().join(", ");
        notes.push(Note::new(Subject::Layout, format!("The topic `{chosen}` was read; others were passed over: {names}.")));
    }
    // Note(unwrap): it is one of the keys.
    let topic = topics.remove(&chosen).expect("the chosen topic");
    if topic.incomplete > 0 {
        return Err(format!("{} messages of the topic `{chosen}` lack numbers that its first message has", topic.incomplete));
    }
    let (mut names, mut columns) = (topic.names, topic.columns);
    names.push("log_time_s".to_owned());
    columns.push(topic.log_time_s);
    Ok(Arrays { names, columns, notes })
}

/// Writes columns as messages with a JSON schema; the first column is the time in s.
pub(super) fn write(columns: &[(String, &[f64])], provenance: &str) -> Result<Vec<u8>, String> {
    let failed = |error: mcap::McapError| error.to_string();
    let options = WriteOptions::new().profile("").library("catheter").compression(Some(Compression::Zstd)).chunk_size(Some(1 << 20));
    let mut writer = options.create(Cursor::new(Vec::new())).map_err(failed)?;
    let properties: serde_json::Map<String, Value> =
        columns.iter().map(|(name, _)| (name.clone(), serde_json::json!({"type": "number"}))).collect();
    let schema = serde_json::json!({"title": "catheter.Sample", "type": "object", "properties": properties});
    let schema = writer.add_schema("catheter.Sample", "jsonschema", schema.to_string().as_bytes()).map_err(failed)?;
    let channel_id = writer.add_channel(schema, TOPIC, "json", &BTreeMap::new()).map_err(failed)?;
    let start_s = columns[0].1.first().copied().unwrap_or_default();
    let mut text = String::new();
    for sample in 0..columns[0].1.len() {
        text.clear();
        for (index, (name, values)) in columns.iter().enumerate() {
            text.push_str(if index == 0 { "{" } else { "," });
            let number = serde_json::Number::from_f64(values[sample]).ok_or("a value is not finite")?;
            text.push_str(&format!("{}:{number}", Value::from(name.as_str())));
        }
        text.push('}');
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "times rise; beyond 584 years they saturate")]
        let log_time = ((columns[0].1[sample] - start_s) * 1e9).round() as u64;
        let header = MessageHeader { channel_id, sequence: sample as u32, log_time, publish_time: log_time };
        writer.write_to_known_channel(&header, text.as_bytes()).map_err(failed)?;
    }
    if !provenance.is_empty() {
        let metadata = BTreeMap::from([("line".to_owned(), provenance.to_owned())]);
        writer.write_metadata(&Metadata { name: "provenance".to_owned(), metadata }).map_err(failed)?;
    }
    writer.finish().map_err(failed)?;
    Ok(writer.into_inner().into_inner())
}
