"""From measurements to models: motion logs, constant-speed runs and frequency responses, each with honest errors."""
