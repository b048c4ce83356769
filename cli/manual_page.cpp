#include "cli/manual_page.h"

#include "cli/help_text.h"
#include "gld/report/provenance.h"

#include <algorithm>
#include <sstream>

namespace gld {
namespace {

std::string bold(const std::string& text) { return "\\fB" + troff_text(text) + "\\fR"; }
std::string italic(const std::string& text) { return "\\fI" + troff_text(text) + "\\fR"; }

std::string entry(const std::string& name, const std::string& value, const std::string& help) {
  return ".TP\n" + bold(name) + (value.empty() ? "" : " " + italic(value)) + "\n" + troff_text(help) + "\n";
}

// Each line of a description is one of the page: they are examples, or sentences as long as a paragraph.
std::string paragraphs(const std::string& text) {
  std::istringstream lines(text);
  std::string result, line;
  while (std::getline(lines, line)) result += ".PP\n" + troff_text(line) + "\n";
  return result;
}

std::string section(const Command& command, const OutermostTypes& outermost) {
  std::string text =
      ".SS \"" + troff_text("gld " + command.name) + "\"\n" + troff_text(command.summary) + ".\n";
  text += paragraphs(command.description);
  if (!command.subcommands.empty()) return text;
  text += ".PP\n" + bold(usage_line(command)) + "\n";
  for (const auto& group : group_flags(command, outermost)) {
    if (!group.key.empty()) {
      std::string heading = "--" + group.key + ".*";
      std::replace(heading.begin(), heading.end(), '_', '-');
      text += ".PP\n" + bold(heading) + (group.help.empty() ? "" : troff_text(": " + group.help)) + "\n";
    }
    for (const Flag& flag : group.flags) text += entry(shown_name(flag), type_of_value(flag), flag.help);
  }
  return text;
}

}  // namespace

std::string troff_text(const std::string& text) {
  std::string result;
  bool begins_line = true;
  for (const char letter : text) {
    if (begins_line && (letter == '.' || letter == '\'')) result += "\\&";
    begins_line = letter == '\n';
    if (letter == '\\') {
      result += "\\e";
    } else if (letter == '-') {
      result += "\\-";
    } else if (letter == '"') {
      result += "\\(dq";  // it would end the argument of a request
    } else {
      result += letter;
    }
  }
  return result;
}

std::string manual_page(const std::vector<Command>& commands, const OutermostTypes& outermost) {
  std::string text = ".TH GLD 1 \"\" \"" + troff_text(program_version()) + "\" \"User Commands\"\n";
  // Text is neither justified nor hyphenated: names of options stay whole.
  text += ".nh\n.ad l\n.SH NAME\ngld \\- novel views of a scene from a few photographs\n";
  text += ".SH SYNOPSIS\n" + bold("gld") + " " + italic("COMMAND") + " [options]\n";
  text += ".br\n" + bold("gld") + " " + italic("COMMAND") + " " + bold("--help") + " | " +
          bold("--help-all") + "\n";
  text += ".br\n" + bold("gld help") + " [" + italic("COMMAND") + " | " + bold("--man") + "]\n";
  text += ".br\n" + bold("gld --version") + "\n";
  text += ".SH DESCRIPTION\n";
  text += paragraphs(
      "Multi-view Geometric Latent Diffusion: photographs with or without cameras become novel views with depth and a "
      "point cloud; the models that do so are converted, trained and measured by the same program.\n"
      "Below a heading such as --solver.*, --evaluations is also taken as --solver.evaluations. Switches are --name "
      "and --no-name. A value in brackets is a range, one behind = the default. Lists are divided at commas.");
  text += ".SH OPTIONS OF EVERY COMMAND\n";
  text += entry("--help", "", "the usual options of a command");
  text += entry("--help-all", "", "every option of a command");
  for (const auto& flag : common_flags()) text += entry(flag.name, flag.value, flag.help);
  text += ".SH COMMANDS\n";
  for (const Command* command : all_levels(commands)) text += section(*command, outermost);
  text += ".SH EXIT STATUS\n";
  text += ".TP\n0\nthe command is done\n.TP\n1\nit failed\n.TP\n2\nwrong usage: nothing was begun\n";
  text += ".TP\n130\nit was interrupted\n";
  return text;
}

}  // namespace gld
