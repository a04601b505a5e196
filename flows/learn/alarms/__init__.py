"""A stated rate of false alarms: settings of `Debounce` that keep it with a stated confidence."""
