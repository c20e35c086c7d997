//! Requests about models: upload, check, activation.

use model_export::blob::{self, crc32};
use model_export::link::fault::Fault;
use model_export::link::message::Refusal;

use super::requests::SessionState;
use crate::storage::{Flash, Slot, StorageError};

impl<S: Flash, M: Flash> SessionState<S, M> {
    pub(super) fn begin_upload(&mut self, length: u32, crc32: u32) -> Result<(), Refusal> {
        self.may_write()?;
        self.upload = None;
        self.upload = Some(self.model_store.begin(length, crc32).map_err(refusal)?);
        Ok(())
    }

    pub(super) fn write_upload(&mut self, offset: u32, bytes: &[u8]) -> Result<u32, Refusal> {
        self.may_write()?;
        let upload = self.upload.as_mut().ok_or(Refusal::NoUpload)?;
        self.model_store.write(upload, offset, bytes).map_err(refusal)?;
        Ok(upload.next_offset())
    }

    /// The checksum before anything else: a damaged blob is not a wrong model.
    pub(super) fn check_upload(&mut self) -> Result<(), Refusal> {
        self.may_write()?;
        let upload = self.upload.as_ref().ok_or(Refusal::NoUpload)?;
        if upload.is_complete(crc32(0, self.model_store.uploaded(upload))) {
            return Ok(());
        }
        self.upload = None;
        Err(Refusal::Checksum)
    }

    pub(super) fn finish_upload(&mut self, checked: Result<(), Fault>) -> Result<(), Refusal> {
        let upload = self.upload.take().ok_or(Refusal::NoUpload)?;
        checked.map_err(|fault| match fault {
            Fault::ModelTooSlow => Refusal::ModelTooSlow,
            Fault::ModelInputs => Refusal::ModelInputs,
            _ => Refusal::NotAModel,
        })?;
        self.model_store.finish(upload).map_err(refusal).map(|_| ())
    }

    pub(super) fn model_in(&self, slot: Slot) -> Option<[u8; 8]> {
        blob::content_id(self.model_store.payload(slot)?)
    }

    /// The model that is active and not damaged.
    pub(super) fn active_model(&self) -> Option<[u8; 8]> {
        let selection = self.model_store.select();
        self.model_in(selection.active.filter(|_| !selection.is_damaged)?)
    }

    pub(super) fn activate(&mut self, id: [u8; 8]) -> Result<(), Refusal> {
        self.may_write()?;
        let slot = Slot::BOTH.into_iter().find(|slot| self.model_in(*slot) == Some(id)).ok_or(Refusal::NoOtherModel)?;
        self.model_store.activate(slot).map_err(refusal)
    }
}

/// What a store's error is to the host.
pub(super) fn refusal(error: StorageError) -> Refusal {
    match error {
        StorageError::Flash => Refusal::Storage,
        StorageError::LogFull => Refusal::LogFull,
        StorageError::TooLong(capacity) => Refusal::TooLong(capacity),
        StorageError::Offset(offset) => Refusal::UploadOffset(offset),
        StorageError::PieceLength => Refusal::PieceLength,
        StorageError::Checksum => Refusal::Checksum,
        StorageError::NotWhole => Refusal::NoOtherModel,
    }
}
