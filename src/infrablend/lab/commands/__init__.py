"""Commands of the lab. `cli.app.LAB_COMMANDS` names them."""
