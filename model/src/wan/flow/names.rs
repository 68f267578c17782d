//! What the renderer's tensors are called in files. The backbone has diffusers' names; the rest has names of this program:
//!
//! | name | shape | what |
//! |---|---|---|
//! | `attribute_embedding` | `[width, 2 z + s^2 + 3 z, 1, 2, 2]` | other buffers and the masked reference |
//! | `environment_embedding` | `[width, z, 1, 2, 2]` | environment |
//! | `blocks.i.environment_proj` | `[2 width, width]` | gamma, then beta |
//! | `keyframe_embedding` | `[width, z, 2, 2]` | keyframes |
//! | `blocks.i.keyframe_attn.{to_q,to_k,to_v,to_out.0,norm_q,norm_k}` | as `blocks.i.attn1` | without `to_q` and `norm_q` where queries are reused |
//! | `blocks.i.ffn.{net.0.proj,net.2}.{lora_A,lora_B}` | `[rank, in]`, `[out, rank]` | correction with keyframes |
//! | `inverse_embedding` | `[width, z, 1, 2, 2]` | picture |
//! | `inverse_prompts` | `[prompts, tokens, width]` | albedo, normal, depth, material, reserve |
//! | `blocks.i.attn1.{to_q,to_k,to_v}.{lora_A,lora_B}` | `[rank, width]`, `[width, rank]` | correction on the way back |
//! | `blocks.i.{inverse_attn,inverse_norm}` | as `blocks.i.{attn2,norm2}` | cross-attention to the prompt |
//! | `inverse_heads.{albedo,normal,depth,material}.{linear_1,linear_2}` | `[width, width]`, `[4 z, width]` | velocity |

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
