"""What a plan will take before it runs."""
