"""Pictures and tables of training runs, from what their workdirs hold."""
