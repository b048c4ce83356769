#include "cli/completion_command.h"

#include "cli/completion_script.h"
#include "gld/base/error.h"
#include "gld/base/printable_text.h"

#include <iostream>

namespace gld {

Command make_completion_command(std::vector<Command> (*commands)()) {
  Command command;
  command.name = "completion";
  command.summary = "Print a script with which a shell completes commands, flags, values and files";
  command.description =
      "bash: source <(gld completion bash), a line of ~/.bashrc\n"
      "zsh: gld completion zsh > ~/.zfunc/_gld, with fpath+=~/.zfunc before compinit in ~/.zshrc\n"
      "fish: gld completion fish > ~/.config/fish/completions/gld.fish";
  command.arguments = {"bash|zsh|fish", 1, 1};
  command.run = [commands](const std::vector<std::string>& arguments) {
    const auto all = commands();
    const OutermostTypes outermost = outermost_types(all);
    const std::string& shell = arguments[0];
    if (shell == "bash") {
      std::cout << bash_completion(all, outermost);
    } else if (shell == "zsh") {
      std::cout << zsh_completion(all, outermost);
    } else if (shell == "fish") {
      std::cout << fish_completion(all, outermost);
    } else {
      fail({"gld completion", "bash, zsh or fish", "'" + printable_text(shell) + "'", "name one of them"});
    }
    return 0;
  };
  return command;
}

}  // namespace gld
