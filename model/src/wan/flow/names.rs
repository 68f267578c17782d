//! The renderer's tensors by the names they have in files; the table of them is in the documentation of [`super`].

use super::Flow;
use crate::wan::names::{self, Entry, Listing, Named};

impl Named for Flow {
    fn entries(&self) -> Vec<Entry> {
        let mut list = Listing::new(names::dit_original);
        let [pf, ph, pw] = self.config.dit.patch_size;
        let patch = [self.config.dit.in_channels, pf, ph, pw];
        self.dit.list(&mut list);
        self.attributes.list(&mut list, "attribute_embedding", &[self.config.attribute_channels(), pf, ph, pw]);
        self.environment.list(&mut list, &patch);
        if let Some(keyframes) = &self.keyframes {
            keyframes.list(&mut list, &patch);
        }
        if let Some(inverse) = &self.inverse {
            inverse.list(&mut list, &patch);
        }
        list.into_entries()
    }
}
