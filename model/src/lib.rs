//! Single-step neural renderer: network, bridge matching, training, inference, LPIPS
