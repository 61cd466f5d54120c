"""Questions asked of the method: studies, the paper's tables, benchmarks and generated shapes. The product never imports it."""
