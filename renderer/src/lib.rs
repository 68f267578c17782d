//! CPU path tracer: compiled scenes, Disney materials, environment light, G-buffers, film
