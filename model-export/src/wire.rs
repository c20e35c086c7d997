//! postcard in place: reads and writes the [wire format] without a copy on the way.
//!
//! The crate `postcard` hands every value up through serde by moving it, and makes that code anew for each type: on the microcontroller
//! the largest model stood on the stack five times while it was read. Here a value is read into the place where it will stay, and
//! the code for numbers exists once. The types derive serde's traits as well; tests hold both against each other, byte by byte.
//!
//! A [`Reader`] or [`Writer`] that fails goes on with zeros, or writes nothing more, and tells at the end. Each is of one schema version:
//! a field that came with a later one is not there, and reads as its default.
//!
//! [wire format]: https://postcard.jamesmunns.com/wire-format

use heapless::Vec;

/// What can be read into its place and written from there.
pub trait Wire<'a> {
    /// Reads a value over the one that is here.
    fn read(&mut self, from: &mut Reader<'a>);

    /// Writes the value.
    fn write(&self, to: &mut Writer<'_>);
}

/// Takes values off the front of some bytes.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    rest: &'a [u8],
    is_sound: bool,
    version: u16,
}

impl<'a> Reader<'a> {
    /// Over all of `bytes`, in the newest version.
    #[must_use]
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self::of_version(bytes, u16::MAX)
    }

    /// Over all of `bytes`, in a schema version.
    #[must_use]
    pub const fn of_version(bytes: &'a [u8], version: u16) -> Self {
        Self { rest: bytes, is_sound: true, version }
    }

    /// The schema version that is read.
    #[must_use]
    pub const fn version(&self) -> u16 {
        self.version
    }

    /// What has not been read yet; `None` if anything before it could not be.
    #[must_use]
    pub fn finish(&self) -> Option<&'a [u8]> {
        if self.is_sound { Some(self.rest) } else { None }
    }

    /// Says that what was read cannot be.
    pub fn refuse(&mut self) {
        self.is_sound = false;
        self.rest = &[];
    }

    /// The next byte.
    #[inline(never)]
    pub fn byte(&mut self) -> u8 {
        let Some((byte, rest)) = self.rest.split_first() else {
            self.refuse();
            return 0;
        };
        self.rest = rest;
        *byte
    }

    /// The next bytes.
    #[inline(never)]
    pub fn bytes(&mut self, length: usize) -> &'a [u8] {
        let Some((bytes, rest)) = self.rest.split_at_checked(length) else {
            self.refuse();
            return &[];
        };
        self.rest = rest;
        bytes
    }

    /// A number of up to 32 bits, seven to a byte, lowest first.
    #[inline(never)]
    pub fn number(&mut self, bits: u32) -> u32 {
        let mut number = 0;
        for shift in (0..bits).step_by(7) {
            let byte = self.byte();
            let part = u32::from(byte & 0x7f);
            // Bits beyond the highest: the last byte has room for more than there are.
            if part.unbounded_shr(bits - shift) != 0 {
                break;
            }
            number |= part << shift;
            if byte & 0x80 == 0 {
                return number;
            }
        }
        self.refuse();
        0
    }

    /// A number of up to 64 bits.
    #[inline(never)]
    fn long_number(&mut self) -> u64 {
        let mut number = 0;
        for shift in (0..u64::BITS).step_by(7) {
            let byte = self.byte();
            let part = u64::from(byte & 0x7f);
            if part.unbounded_shr(u64::BITS - shift) != 0 {
                break;
            }
            number |= part << shift;
            if byte & 0x80 == 0 {
                return number;
            }
        }
        self.refuse();
        0
    }

    /// How many items follow.
    fn length(&mut self) -> usize {
        usize::try_from(self.number(u32::BITS)).unwrap_or(usize::MAX)
    }

    /// A yes or no.
    fn flag(&mut self) -> bool {
        match self.byte() {
            0 => false,
            1 => true,
            _ => {
                self.refuse();
                false
            }
        }
    }
}

/// Puts values behind each other.
#[derive(Debug)]
pub struct Writer<'p> {
    place: &'p mut [u8],
    length: usize,
    version: u16,
}

impl<'p> Writer<'p> {
    /// Into `place`, from its front, in the newest version.
    pub const fn new(place: &'p mut [u8]) -> Self {
        Self::of_version(place, u16::MAX)
    }

    /// Into `place`, from its front, in a schema version.
    pub const fn of_version(place: &'p mut [u8], version: u16) -> Self {
        Self { place, length: 0, version }
    }

    /// The schema version that is written.
    #[must_use]
    pub const fn version(&self) -> u16 {
        self.version
    }

    /// Bytes written; `None` if they did not fit.
    #[must_use]
    pub fn finish(&self) -> Option<usize> {
        if self.length <= self.place.len() { Some(self.length) } else { None }
    }

    /// Writes a byte.
    #[inline(never)]
    pub fn byte(&mut self, byte: u8) {
        if let Some(place) = self.place.get_mut(self.length) {
            *place = byte;
        }
        self.length = self.length.saturating_add(1);
    }

    /// Writes bytes as they are.
    #[inline(never)]
    pub fn bytes(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.byte(*byte);
        }
    }

    /// Writes a number, seven bits to a byte, lowest first.
    #[inline(never)]
    pub fn number(&mut self, number: u32) {
        self.long_number(u64::from(number));
    }

    #[inline(never)]
    fn long_number(&mut self, mut number: u64) {
        loop {
            let [low, ..] = number.to_le_bytes();
            number >>= 7;
            if number == 0 {
                return self.byte(low & 0x7f);
            }
            self.byte(low | 0x80);
        }
    }

    fn length(&mut self, length: usize) {
        // No place of ours is that long.
        self.number(u32::try_from(length).unwrap_or(u32::MAX));
    }
}

/// Reads all of `bytes` into a place; whether they were that and nothing else. What is in the place otherwise means nothing.
#[must_use]
pub fn read_all<'a>(place: &mut impl Wire<'a>, bytes: &'a [u8]) -> bool {
    let mut reader = Reader::new(bytes);
    place.read(&mut reader);
    reader.finish().is_some_and(<[u8]>::is_empty)
}

/// Writes a value to the front of `place` and gives the length; `None` if it does not fit.
pub fn write<'a>(value: &impl Wire<'a>, place: &mut [u8]) -> Option<usize> {
    let mut writer = Writer::new(place);
    value.write(&mut writer);
    writer.finish()
}

impl Wire<'_> for u8 {
    fn read(&mut self, from: &mut Reader<'_>) {
        *self = from.byte();
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.byte(*self);
    }
}

impl Wire<'_> for bool {
    fn read(&mut self, from: &mut Reader<'_>) {
        *self = from.flag();
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.byte(u8::from(*self));
    }
}

impl Wire<'_> for u16 {
    fn read(&mut self, from: &mut Reader<'_>) {
        // No more than its bits come.
        *self = u16::try_from(from.number(u16::BITS)).unwrap_or(0);
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.number(u32::from(*self));
    }
}

impl Wire<'_> for u32 {
    fn read(&mut self, from: &mut Reader<'_>) {
        *self = from.number(u32::BITS);
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.number(*self);
    }
}

impl Wire<'_> for u64 {
    fn read(&mut self, from: &mut Reader<'_>) {
        *self = from.long_number();
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.long_number(*self);
    }
}

/// Zigzag: the sign in the lowest bit.
impl Wire<'_> for i32 {
    fn read(&mut self, from: &mut Reader<'_>) {
        let number = from.number(u32::BITS);
        *self = (number >> 1).cast_signed() ^ -((number & 1).cast_signed());
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.number(((self << 1) ^ (self >> 31)).cast_unsigned());
    }
}

impl Wire<'_> for f32 {
    fn read(&mut self, from: &mut Reader<'_>) {
        *self = from.bytes(4).first_chunk().map_or(0.0, |bytes| f32::from_le_bytes(*bytes));
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.bytes(&self.to_le_bytes());
    }
}

/// Bytes as they are, as of a tuple.
impl<const N: usize> Wire<'_> for [u8; N] {
    fn read(&mut self, from: &mut Reader<'_>) {
        *self = from.bytes(N).first_chunk().copied().unwrap_or([0; N]);
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.bytes(self);
    }
}

impl<'a> Wire<'a> for &'a [u8] {
    fn read(&mut self, from: &mut Reader<'a>) {
        let length = from.length();
        *self = from.bytes(length);
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.length(self.len());
        to.bytes(self);
    }
}

impl<'a> Wire<'a> for &'a str {
    fn read(&mut self, from: &mut Reader<'a>) {
        let mut bytes: &[u8] = &[];
        bytes.read(from);
        match core::str::from_utf8(bytes) {
            Ok(text) => *self = text,
            Err(_) => from.refuse(),
        }
    }
    fn write(&self, to: &mut Writer<'_>) {
        self.as_bytes().write(to);
    }
}

impl<'a, T: Wire<'a> + Default> Wire<'a> for Option<T> {
    fn read(&mut self, from: &mut Reader<'a>) {
        if from.flag() {
            self.get_or_insert_default().read(from);
        } else {
            *self = None;
        }
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.byte(u8::from(self.is_some()));
        if let Some(value) = self {
            value.write(to);
        }
    }
}

impl<'a, T: Wire<'a> + Default, const N: usize> Wire<'a> for Vec<T, N> {
    fn read(&mut self, from: &mut Reader<'a>) {
        let length = from.length();
        self.clear();
        if length > N {
            from.refuse();
        }
        for _ in 0..length.min(N) {
            // There is room: the list was emptied.
            let _ = self.push(T::default());
            if let Some(last) = self.last_mut() {
                last.read(from);
            }
        }
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.length(self.len());
        self.iter().for_each(|item| item.write(to));
    }
}

/// Implements [`Wire`] for a struct: every field, in the order of its declaration, the first perhaps only from a schema version on; what
/// stands behind a semicolon is no part of it.
macro_rules! wire_struct {
    ($type:ty { $([from $version:literal] $newer:ident,)? $($field:ident),* $(,)? $(; $skipped:ident)? }) => {
        impl<'a> $crate::wire::Wire<'a> for $type {
            fn read(&mut self, from: &mut $crate::wire::Reader<'a>) {
                let Self { $($newer,)? $($field,)* $($skipped: _)? } = self;
                $(if from.version() >= $version {
                    $crate::wire::Wire::read($newer, from);
                } else {
                    *$newer = Default::default();
                })?
                $($crate::wire::Wire::read($field, from);)*
            }
            fn write(&self, to: &mut $crate::wire::Writer<'_>) {
                let Self { $($newer,)? $($field,)* $($skipped: _)? } = self;
                $(if to.version() >= $version {
                    $crate::wire::Wire::write($newer, to);
                })?
                $($crate::wire::Wire::write($field, to);)*
            }
        }
    };
}

/// Implements [`Wire`] for an enum: its variants in the order of their declaration, each with its number.
macro_rules! wire_enum {
    ($type:ty { $($number:literal $variant:ident $(($value:ident))? $({ $($field:ident),* })?,)* }) => {
        impl<'a> $crate::wire::Wire<'a> for $type {
            fn read(&mut self, from: &mut $crate::wire::Reader<'a>) {
                match from.number(u32::BITS) {
                    $($number => {
                        // The variant first, so that its fields are read into their place.
                        *self = Self::$variant $(({ let $value = Default::default(); $value }))? $({ $($field: Default::default()),* })?;
                        if let Self::$variant $(($value))? $({ $($field),* })? = self {
                            $($crate::wire::Wire::read($value, from);)?
                            $($($crate::wire::Wire::read($field, from);)*)?
                        }
                    })*
                    _ => from.refuse(),
                }
            }
            fn write(&self, to: &mut $crate::wire::Writer<'_>) {
                match self {
                    $(Self::$variant $(($value))? $({ $($field),* })? => {
                        to.number($number);
                        $($crate::wire::Wire::write($value, to);)?
                        $($($crate::wire::Wire::write($field, to);)*)?
                    })*
                }
            }
        }
    };
}

pub(crate) use {wire_enum, wire_struct};
